#include "journal.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sodium.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <map>
#include <utility>

#include "fiona/error.hpp"

namespace fiona::host {
namespace {

/// A file that has grown to this is replaced by one record that builds the system as it is.
constexpr std::uint64_t kFoldBytes = 4 * 1024 * 1024;
constexpr std::size_t kHeadBytes = 8;
constexpr std::size_t kMaxRecord = 16 * 1024 * 1024;
constexpr std::chrono::seconds kSyncPeriod{1};

std::uint32_t checksum(std::string_view bytes) {
  std::array<unsigned char, crypto_generichash_BYTES_MIN> hash{};
  crypto_generichash(hash.data(), hash.size(), reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(),
                     nullptr, 0);
  return hash[0] | hash[1] << 8U | hash[2] << 16U | static_cast<std::uint32_t>(hash[3]) << 24U;
}

void append(std::string& out, std::uint32_t number) {
  for (int byte = 0; byte < 4; ++byte) out += static_cast<char>(number >> (8 * byte));
}

std::uint32_t number_at(std::string_view text, std::size_t at) {
  std::uint32_t number = 0;
  for (int byte = 0; byte < 4; ++byte)
    number |= static_cast<std::uint32_t>(static_cast<unsigned char>(text[at + byte])) << (8 * byte);
  return number;
}

[[noreturn]] void fail(const std::filesystem::path& file) {
  throw Error(ErrorCode::Failed, {.what = fmt::format("the journal cannot be written: {}", std::strerror(errno)),
                                  .where = file.string(),
                                  .next = "make room or correct the rights there, then try again"});
}

std::int64_t now_ms() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
}

os::Descriptor open_new(const std::filesystem::path& file) {
  os::Descriptor opened(::open(file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600));
  if (!opened) fail(file);
  return opened;
}

/// A name that a file has been given is on the disk when its directory is. Some file systems sync none: they say
/// EINVAL.
void sync_name(const std::filesystem::path& file) {
  const std::filesystem::path folder = file.has_parent_path() ? file.parent_path() : ".";
  const os::Descriptor opened(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!opened || (::fsync(opened.get()) != 0 && errno != EINVAL)) fail(folder);
}

std::optional<std::string> text_of_file(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream) return std::nullopt;
  return std::string{std::istreambuf_iterator<char>(stream), {}};
}

void write_all(int descriptor, std::string_view bytes, const std::filesystem::path& file) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(descriptor, bytes.data(), bytes.size());
    if (written < 0 && errno != EINTR) fail(file);
    if (written > 0) bytes.remove_prefix(static_cast<std::size_t>(written));
  }
}

}  // namespace

std::string Journal::record_of(const control::JournalEntry& entry) {
  const std::string body = entry.SerializeAsString();
  std::string record;
  append(record, static_cast<std::uint32_t>(body.size()));
  append(record, checksum(body));
  return record + body;
}

Journal::Journal(std::filesystem::path file, std::optional<Told> before) : file_(std::move(file)) {
  std::string records = record_of({});
  for (auto& entry : before ? before->entries : std::vector<control::JournalEntry>()) {
    if (entry.number() == 0) continue;
    next_number_ = std::max(next_number_, entry.number() + 1);
    if (entry.state() == control::JournalEntry::UNDER_WAY) {
      entry.set_state(control::JournalEntry::ROLLED_BACK);
      entry.set_reason("the host ended before it was done");
    }
    records += record_of(entry);
    entries_.push_back(std::move(entry));
  }
  std::ranges::sort(entries_, {}, &control::JournalEntry::number);
  while (entries_.size() > kMaxEntries) entries_.pop_front();
  if (file_.empty()) return;
  const bool whole = before && before->damaged == 0 && !before->older;
  replace(records, !before ? ".old" : whole ? nullptr : ".damaged");
  syncer_ = std::thread([this] { sync_until_closed(); });
}

/// Beside the file and renamed over it: whoever reads finds the old text or the new one. `set_aside`: the old text
/// stays under this name.
void Journal::replace(const std::string& records, const char* set_aside) {
  const std::filesystem::path fresh = file_.string() + ".new";
  os::Descriptor opened = open_new(fresh);
  write_all(opened.get(), records, fresh);
  if (set_aside) {
    const std::string aside = file_.string() + set_aside;
    ::unlink(aside.c_str());
    static_cast<void>(::link(file_.c_str(), aside.c_str()));  // where there is nothing to set aside, or it cannot be
  }
  if (::fdatasync(opened.get()) != 0 || ::rename(fresh.c_str(), file_.c_str()) != 0) fail(file_);
  sync_name(file_);
  const std::lock_guard lock(mutex_);
  descriptor_ = std::move(opened);
  written_bytes_ = records.size();
}

Journal::~Journal() {
  if (!syncer_.joinable()) return;
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
  }
  wake_.notify_all();
  syncer_.join();
}

void Journal::sync_until_closed() {
  std::unique_lock lock(mutex_);
  while (dirty_ || !closed_) {
    wake_.wait(lock, [this] { return dirty_ || closed_; });
    if (!std::exchange(dirty_, false)) continue;
    os::Descriptor copy(::fcntl(descriptor_.get(), F_DUPFD_CLOEXEC, 0));
    lock.unlock();
    if (copy) ::fdatasync(copy.get());
    lock.lock();
    wake_.wait_for(lock, kSyncPeriod / 2, [this] { return closed_; });
  }
}

void Journal::write(const control::JournalEntry& entry) {
  if (file_.empty()) return;
  std::string record = record_of(entry);
  if (record.size() > kHeadBytes + kMaxRecord) {
    throw Error(ErrorCode::NotAllowed, {.what = "the change is too large for the journal",
                                        .expected = fmt::format("{} bytes, with what takes it back", kMaxRecord),
                                        .found = fmt::format("{} bytes", record.size() - kHeadBytes),
                                        .next = "make it in parts"});
  }
  record.insert(0, owed_);
  try {
    write_all(descriptor_.get(), record, file_);
  } catch (...) {
    // Behind half a record nothing would be found again.
    static_cast<void>(::ftruncate(descriptor_.get(), static_cast<off_t>(written_bytes_)));
    ::lseek(descriptor_.get(), static_cast<off_t>(written_bytes_), SEEK_SET);
    throw;
  }
  owed_.clear();
  written_bytes_ += record.size();
  {
    const std::lock_guard lock(mutex_);
    dirty_ = true;
  }
  wake_.notify_all();
}

std::uint64_t Journal::begin(control::JournalEntry entry) {
  entry.set_number(next_number_);
  entry.set_time_ms(now_ms());
  entry.set_state(control::JournalEntry::UNDER_WAY);
  write(entry);
  entries_.push_back(std::move(entry));
  if (entries_.size() > kMaxEntries) {
    // Not one that is under way: its end would not be told.
    const auto oldest =
        std::ranges::find_if(entries_, [](const auto& one) { return one.state() != control::JournalEntry::UNDER_WAY; });
    if (oldest != entries_.end()) entries_.erase(oldest);
  }
  return next_number_++;
}

control::JournalEntry* Journal::find(std::uint64_t number) {
  const auto found =
      std::find_if(entries_.rbegin(), entries_.rend(), [&](const auto& one) { return one.number() == number; });
  return found == entries_.rend() ? nullptr : &*found;
}

void Journal::set_reverse(std::uint64_t number, const std::vector<control::Change>& reverse) {
  control::JournalEntry* entry = find(number);
  if (entry) entry->mutable_reverse()->Assign(reverse.begin(), reverse.end());
}

void Journal::end(std::uint64_t number, control::JournalEntry::State state, const std::string& reason,
                  const Model* whole) {
  control::JournalEntry* entry = find(number);
  if (!entry) return;
  entry->set_state(state);
  entry->set_reason(reason);
  if (control::JournalEntry* undone = state == control::JournalEntry::DONE ? find(entry->undoes()) : nullptr) {
    undone->set_state(control::JournalEntry::UNDONE);
  }
  try {
    write(*entry);
  } catch (...) {
    const std::string record = record_of(*entry);
    if (record.size() <= kHeadBytes + kMaxRecord) owed_ += record;  // else it would not be read
    throw;
  }
  if (whole && written_bytes_ > kFoldBytes) fold(*whole);
}

const control::JournalEntry* Journal::last_done() const {
  const auto is_being_undone = [this](const control::JournalEntry& entry) {
    return std::any_of(entries_.begin(), entries_.end(), [&entry](const auto& one) {
      return one.state() == control::JournalEntry::UNDER_WAY && one.undoes() == entry.number();
    });
  };
  const auto found = std::find_if(entries_.rbegin(), entries_.rend(), [&](const auto& one) {
    return one.state() == control::JournalEntry::DONE && one.undoes() == 0 && one.reverse_size() > 0 &&
           !is_being_undone(one);
  });
  return found == entries_.rend() ? nullptr : &*found;
}

/// What is folded is set aside: it ends with the same system, for when this one is damaged.
void Journal::fold(const Model& whole) {
  control::JournalEntry all;
  all.set_number(next_number_++);
  all.set_state(control::JournalEntry::DONE);
  all.set_time_ms(now_ms());
  for (auto& step : Model::difference(Model(), whole)) *all.add_steps() = std::move(step);
  std::string records = record_of({}) + record_of(all);
  if (all.ByteSizeLong() > kMaxRecord) return;  // it would not be read
  for (const auto& entry : entries_) {
    if (entry.state() == control::JournalEntry::UNDER_WAY) records += record_of(entry);
  }
  replace(records, ".old");
}

Journal::Told Journal::read(const std::filesystem::path& file) {
  const auto text = text_of_file(file);
  if (!text)
    throw Error(ErrorCode::NotFound,
                {.what = "there is no journal", .where = file.string(), .next = "start the host without --restore"});
  Told told = told_by(*text);
  if (told.bytes > 0) return told;
  Told older = told_by(text_of_file(file.string() + ".old").value_or(""));
  older.older = true;
  older.damaged = text->size();
  if (older.bytes > 0) return older;
  throw Error(ErrorCode::Failed,
              {.what = "the journal cannot be read: its first record is damaged, and there is none before it",
               .where = file.string(),
               .found = fmt::format("{} bytes", text->size()),
               .next = "begin without --restore"});
}

Journal::Told Journal::told_by(std::string_view text) {
  Told told;
  std::vector<control::JournalEntry> records;
  std::map<std::uint64_t, std::size_t> last;  // of each number
  while (told.bytes + kHeadBytes <= text.size()) {
    const std::size_t size = number_at(text, told.bytes);
    if (size > kMaxRecord || size > text.size() - told.bytes - kHeadBytes) break;
    const std::string_view body = text.substr(told.bytes + kHeadBytes, size);
    control::JournalEntry entry;
    if (checksum(body) != number_at(text, told.bytes + 4) || !entry.ParseFromArray(body.data(), static_cast<int>(size)))
      break;
    told.last_ms = std::max(told.last_ms, entry.time_ms());
    last[entry.number()] = records.size();
    records.push_back(std::move(entry));
    told.bytes += kHeadBytes + size;
  }
  told.damaged = text.size() - told.bytes;
  using Entry = control::JournalEntry;
  for (std::size_t at = 0; at < records.size(); ++at) {
    Entry& entry = records[at];
    if (last[entry.number()] != at) continue;
    const bool happened = entry.state() == Entry::DONE || entry.state() == Entry::UNDONE;
    if (happened) told.changes.insert(told.changes.end(), entry.steps().begin(), entry.steps().end());
    // What is undone has happened before.
    const auto undone = last.find(entry.undoes());
    const bool undoes = happened && entry.undoes() != 0 && undone != last.end() && undone->second < at;
    if (undoes && records[undone->second].state() == Entry::DONE) records[undone->second].set_state(Entry::UNDONE);
  }
  for (std::size_t at = 0; at < records.size(); ++at) {
    if (last[records[at].number()] == at) told.entries.push_back(std::move(records[at]));
  }
  return told;
}

}  // namespace fiona::host
