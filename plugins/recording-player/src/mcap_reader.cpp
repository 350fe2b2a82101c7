#include "mcap_reader.hpp"

#include <archive.h>
#include <archive_entry.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fmt/format.h>
#include <fiona/error.hpp>

namespace fiona::recording_player {
namespace {

// The numbers are those of the specification's records.
enum Op : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kDataEnd = 0x0F,
};

constexpr std::string_view kMagic{"\x89MCAP0\r\n", 8};
constexpr std::uint64_t kRecordHead = 1 + 8;
constexpr std::uint64_t kMessageHead = 2 + 4 + 8 + 8;
constexpr std::uint64_t kWindow = 64 * 1024;
constexpr std::uint64_t kLargestLoose = 1024 * 1024;
// What a file may cost at most.
constexpr std::uint64_t kLargestChunk = 80 * 1024 * 1024;  ///< a link carries messages of 64 MiB
constexpr std::uint64_t kMostLoaded = 256 * 1024 * 1024;
constexpr std::uint64_t kMostSchemas = 64 * 1024 * 1024;
constexpr std::size_t kMostRegions = 1'000'000;
constexpr std::uint64_t kLargestDefinition = 16 * 1024 * 1024;

/// The fields of a record, little endian, in their order; `ok` is false once one did not fit.
class Fields {
 public:
  explicit Fields(std::string_view content) : rest_(content) {}

  template <class T>
  T number() {
    const std::string_view taken = take(sizeof(T));
    T value = 0;
    for (std::size_t i = taken.size(); i-- > 0;)
      value = static_cast<T>(value << 8 | static_cast<std::uint8_t>(taken[i]));
    return value;
  }
  std::string_view text() { return take(number<std::uint32_t>()); }
  std::string_view take(std::uint64_t size) {
    if (size > rest_.size()) {
      ok_ = false;
      rest_ = {};
      return {};
    }
    const std::string_view taken = rest_.substr(0, size);
    rest_.remove_prefix(size);
    return taken;
  }
  std::string_view rest() const { return rest_; }
  bool ok() const { return ok_; }

 private:
  std::string_view rest_;
  bool ok_ = true;
};

/// Calls `take(op, content)` for each whole record; false: the last one is not whole.
template <class F>
bool each_record(std::string_view records, F take) {
  std::uint64_t at = 0;
  while (at < records.size()) {
    if (records.size() - at < kRecordHead) return false;
    Fields head(records.substr(at, kRecordHead));
    const auto op = head.number<std::uint8_t>();
    const auto size = head.number<std::uint64_t>();
    at += kRecordHead;
    if (op == 0 || size > records.size() - at) return false;
    take(op, records.substr(at, size));
    at += size;
  }
  return true;
}

McapReader::Message message_of(std::string_view content, bool& ok) {
  Fields fields(content);
  McapReader::Message message;
  message.channel = fields.number<std::uint16_t>();
  fields.number<std::uint32_t>();  // its sequence
  message.logged_ns = fields.number<std::uint64_t>();
  message.published_ns = fields.number<std::uint64_t>();
  message.data = fields.rest();
  ok = fields.ok();
  return message;
}

/// Of a record that was read before, and whose content begins at `at`.
McapReader::Message message_at(std::string_view records, std::uint32_t at) {
  Fields length(records.substr(at - sizeof(std::uint64_t)));
  bool ok = false;
  return message_of(records.substr(at, length.number<std::uint64_t>()), ok);
}

/// What `packed` unpacks to, not much more than `size`; or the problem.
std::string unpacked(std::string_view packed, std::string_view compression, std::uint64_t size, std::string& problem) {
  std::string all;
  std::unique_ptr<archive, decltype(&archive_read_free)> reader(archive_read_new(), &archive_read_free);
  const int filter = compression == "zstd" ? archive_read_support_filter_zstd(reader.get())
                                           : archive_read_support_filter_lz4(reader.get());
  archive_entry* entry = nullptr;
  if (filter != ARCHIVE_OK || archive_read_support_format_raw(reader.get()) != ARCHIVE_OK ||
      archive_read_open_memory(reader.get(), packed.data(), packed.size()) != ARCHIVE_OK ||
      archive_read_next_header(reader.get(), &entry) != ARCHIVE_OK || archive_filter_count(reader.get()) != 2) {
    problem = "its compressed bytes are garbled";
    return all;
  }
  const std::unique_ptr<char[]> block(new char[kWindow]);
  la_ssize_t got = 0;
  while (all.size() <= size && (got = archive_read_data(reader.get(), block.get(), kWindow)) > 0)
    all.append(block.get(), static_cast<std::size_t>(got));
  if (got < 0) problem = "its compressed bytes are garbled";
  return all;
}

std::uint32_t checksum_of(std::string_view bytes) {
  return static_cast<std::uint32_t>(
      ::crc32_z(0, reinterpret_cast<const Bytef*>(bytes.data()), static_cast<z_size_t>(bytes.size())));
}

}  // namespace

McapReader::McapReader(const std::filesystem::path& file)
    : file_(file), descriptor_(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK)) {
  if (descriptor_ < 0) {
    throw Error(ErrorCode::NotFound, {.what = fmt::format("cannot read the recording: {}", std::strerror(errno)),
                                      .where = file.string(),
                                      .expected = "a file that `record` has written",
                                      .next = "check its name: the path is one of the host's machine"});
  }
  try {
    struct stat found {};
    if (::fstat(descriptor_, &found) != 0 || !S_ISREG(found.st_mode)) fail(0, "this is no file");
    size_ = static_cast<std::uint64_t>(found.st_size);
    scan();
  } catch (...) {
    ::close(descriptor_);
    throw;
  }
}

McapReader::~McapReader() { ::close(descriptor_); }

void McapReader::fail(std::uint64_t at, const std::string& what) const {
  throw Error(ErrorCode::Failed, {.what = what,
                                  .where = fmt::format("{}, byte {}", file_.string(), at),
                                  .expected = "an MCAP file: https://mcap.dev/spec",
                                  .next = "copy it again from where it was recorded; what else reads it: mcap doctor"});
}

std::string McapReader::bytes(std::uint64_t at, std::uint64_t size) const {
  std::string all(size, '\0');
  std::size_t filled = 0;
  while (filled < size) {
    const ssize_t got = ::pread(descriptor_, all.data() + filled, size - filled, static_cast<off_t>(at + filled));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) fail(at, fmt::format("the recording cannot be read: {}", std::strerror(errno)));
    if (got == 0) fail(at, "the recording has become shorter while it was read");
    filled += static_cast<std::size_t>(got);
  }
  return all;
}

/// `size` bytes at most of a record's beginning.
std::string_view McapReader::head(std::uint64_t at, std::uint64_t size) {
  size = std::min(size, size_ - at);
  if (at < window_at_ || at + size > window_at_ + window_.size()) {
    window_ = bytes(at, std::min(std::max(size, kWindow), size_ - at));
    window_at_ = at;
  }
  return std::string_view(window_).substr(at - window_at_, size);
}

void McapReader::scan() {
  if (size_ < kMagic.size() || head(0, kMagic.size()) != kMagic) fail(0, "this is no recording");
  std::uint64_t at = kMagic.size();
  while (at < size_ && !ended_) {
    if (size_ - at < kRecordHead) break;
    Fields fields(head(at, kRecordHead));
    const auto op = fields.number<std::uint8_t>();
    const auto size = fields.number<std::uint64_t>();
    if (at == kMagic.size() && op != kHeader) fail(at, "the recording does not begin with its header");
    if (op == 0 || size > size_ - at - kRecordHead) break;  // zeros are what a power cut leaves
    scan_record(op, at + kRecordHead, size);
    at += kRecordHead + size;
  }
  window_ = {};
  if (!has_summary_ || is_cut()) define_from_chunks();
  drop_empty_chunks();
  const auto earlier = [](const Region& a, const Region& b) { return a.first_ns < b.first_ns; };
  std::stable_sort(regions_.begin(), regions_.end(), earlier);
}

/// What is not as it should be is left out; a chunk that is damaged within is found when it is read.
void McapReader::scan_record(std::uint8_t op, std::uint64_t at, std::uint64_t size) {
  switch (op) {
    case kFooter: ended_ = true; return;
    case kDataEnd: data_ended_ = true; return;
    case kSchema:
    case kChannel:
      if (size > kLargestDefinition) fail(at, "the description of a channel is larger than 16 MiB");
      has_summary_ |= data_ended_;
      return define(op, bytes(at, size), at);
    case kMessage: {
      Fields fields(head(at, std::min(size, kMessageHead)));
      fields.take(2 + 4);
      const auto logged_ns = fields.number<std::uint64_t>();
      if (size < kMessageHead) return void(++damaged_);
      return add_region(
          {.at = at - kRecordHead, .size = kRecordHead + size, .first_ns = logged_ns, .last_ns = logged_ns});
    }
    case kChunk: {
      Region chunk;
      Fields fields(head(at, std::min(size, kWindow)));
      chunk.first_ns = fields.number<std::uint64_t>();
      chunk.last_ns = std::max(chunk.first_ns, fields.number<std::uint64_t>());
      chunk.unpacked = fields.number<std::uint64_t>();
      chunk.checksum = fields.number<std::uint32_t>();
      chunk.compression = fields.text();
      chunk.size = fields.number<std::uint64_t>();
      const std::uint64_t before = std::min(size, kWindow) - fields.rest().size();
      if (!fields.ok() || chunk.size != size - before) return void(++damaged_);
      chunk.at = at + before;
      chunk.is_chunk = true;
      return add_region(std::move(chunk));
    }
    case kMessageIndex: {
      Fields fields(head(at, std::min<std::uint64_t>(size, sizeof(ChannelId))));
      const auto channel = fields.number<ChannelId>();
      if (fields.ok() && !regions_.empty() && regions_.back().is_chunk) regions_.back().indexed.push_back(channel);
      return;
    }
    default: return;  // an attachment, or what a later version has added
  }
}

void McapReader::define_from_chunks() {
  for (const Region& region : regions_) {
    if (!region.is_chunk) continue;
    try {
      const std::string records = records_of(region);
      each_record(records, [&](std::uint8_t op, std::string_view content) {
        if (op == kSchema || op == kChannel) define(op, content, region.at);
      });
    } catch (const Error&) {  // told when it is to be played
    }
  }
}

/// The format gives a chunk without messages the times 0, which are none.
void McapReader::drop_empty_chunks() {
  std::erase_if(regions_, [this](const Region& region) {
    if (!region.is_chunk || region.last_ns != 0) return false;
    bool has_messages = false;
    try {
      const std::string records = records_of(region);
      each_record(records, [&](std::uint8_t op, std::string_view) { has_messages |= op == kMessage; });
    } catch (const Error&) {
      ++damaged_;
    }
    return !has_messages;
  });
}

void McapReader::add_region(Region region) {
  if (!region.is_chunk && !regions_.empty()) {
    Region& last = regions_.back();
    if (!last.is_chunk && last.at + last.size == region.at && last.size + region.size <= kLargestLoose) {
      last.size += region.size;
      last.first_ns = std::min(last.first_ns, region.first_ns);
      last.last_ns = std::max(last.last_ns, region.last_ns);
      return;
    }
  }
  if (regions_.size() == kMostRegions) fail(region.at, "the recording has more than a million chunks");
  regions_.push_back(std::move(region));
}

/// As a definition is repeated, the first one counts.
void McapReader::define(std::uint8_t op, std::string_view content, std::uint64_t at) {
  Fields fields(content);
  if (op == kSchema) {
    const auto id = fields.number<std::uint16_t>();
    Schema schema{std::string(fields.text()), std::string(fields.text()), std::string(fields.text())};
    if (!fields.ok()) return void(++damaged_);
    if (schemas_.contains(id)) return;
    schema_bytes_ += content.size();
    if (schema_bytes_ > kMostSchemas) fail(at, "the descriptions of its types are larger than 64 MiB");
    schemas_.emplace(id, std::move(schema));
    return;
  }
  const auto id = fields.number<std::uint16_t>();
  const auto schema_id = fields.number<std::uint16_t>();
  Channel channel;
  channel.topic = fields.text();
  channel.encoding = fields.text();
  if (!fields.ok()) return void(++damaged_);
  if (channels_.contains(id)) return;
  if (const auto schema = schemas_.find(schema_id); schema != schemas_.end()) {
    channel.type = schema->second.type;
    channel.schema_encoding = schema->second.encoding;
    channel.schema = schema->second.data;
  }
  schema_bytes_ += channel.schema.size();
  if (schema_bytes_ > kMostSchemas) fail(at, "the descriptions of its types are larger than 64 MiB");
  channels_.emplace(id, std::move(channel));
}

std::uint64_t McapReader::first_ns() const { return regions_.empty() ? 0 : regions_.front().first_ns; }

std::uint64_t McapReader::last_ns() const {
  std::uint64_t last = 0;
  for (const Region& region : regions_) last = std::max(last, region.last_ns);
  return last;
}

void McapReader::select(std::set<ChannelId> channels, std::uint64_t from_ns) {
  selected_ = std::move(channels);
  from_ns_ = from_ns;
}

std::string McapReader::records_of(const Region& region) const {
  const bool packed = !region.compression.empty();
  if (packed && region.unpacked == 0) return {};
  if (packed && region.compression != "lz4" && region.compression != "zstd")
    fail(region.at, fmt::format("a chunk is compressed in a way that is not known here: {}", region.compression));
  if (std::max(region.size, region.unpacked) > kLargestChunk) fail(region.at, "a chunk is larger than 80 MiB");
  std::string records = bytes(region.at, region.size);
  if (!region.is_chunk) return records;
  std::string problem;
  if (packed) records = unpacked(records, region.compression, region.unpacked, problem);
  if (problem.empty() && records.size() != region.unpacked) problem = "it does not have the size that it names";
  if (problem.empty() && region.checksum != 0 && checksum_of(records) != region.checksum)
    problem = "its checksum is another one";
  if (!problem.empty()) fail(region.at, "a chunk is damaged: " + problem);
  return records;
}

bool McapReader::is_wanted(const Region& region) const {
  if (region.last_ns < from_ns_) return false;
  if (!selected_ || region.indexed.empty()) return true;
  return std::any_of(region.indexed.begin(), region.indexed.end(),
                     [this](ChannelId id) { return selected_->contains(id); });
}

void McapReader::load(std::uint32_t number) {
  const Region& region = regions_[number];
  if (loaded_bytes_ + std::max(region.size, region.unpacked) > kMostLoaded)
    fail(region.at, "a chunk is left out: those of one time are larger than 256 MiB");
  std::string records = records_of(region);
  loaded_bytes_ += records.size();
  Loaded& loaded = loaded_[number];
  loaded.records = std::move(records);
  bool is_whole = true;
  is_whole &= each_record(loaded.records, [&](std::uint8_t op, std::string_view content) {
    if (op != kMessage) return;
    bool ok = false;
    const Message message = message_of(content, ok);
    is_whole &= ok;
    if (!ok || message.logged_ns < from_ns_ || (selected_ && !selected_->contains(message.channel))) return;
    ++loaded.waiting;
    waiting_.push({message.logged_ns, number, static_cast<std::uint32_t>(content.data() - loaded.records.data())});
  });
  if (loaded.waiting == 0) unload(number);
  if (!is_whole) fail(region.at, "a chunk is damaged: one of its records is not whole");
}

void McapReader::unload(std::uint32_t number) {
  loaded_bytes_ -= loaded_.at(number).records.size();
  loaded_.erase(number);
}

McapReader::Next McapReader::next(Message& message) {
  if (const auto shown = std::exchange(shown_, std::nullopt); shown && --loaded_.at(*shown).waiting == 0)
    unload(*shown);
  while (next_region_ < regions_.size() && !is_wanted(regions_[next_region_])) ++next_region_;
  if (next_region_ < regions_.size() &&
      (waiting_.empty() || regions_[next_region_].first_ns <= waiting_.top().logged_ns)) {
    load(next_region_++);
    return Next::Later;
  }
  if (waiting_.empty()) return Next::End;
  const Waiting first = waiting_.top();
  waiting_.pop();
  shown_ = first.region;
  message = message_at(loaded_.at(first.region).records, first.at);
  return Next::Message;
}

}  // namespace fiona::recording_player
