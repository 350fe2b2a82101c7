// A journal: whatever its bytes are, reading gives the changes of the records that are whole, and a model takes each of
// them or refuses it in a sentence.
#include <google/protobuf/stubs/logging.h>

#include <cstdint>
#include <cstdlib>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/error.hpp"
#include "journal.hpp"

namespace {

using fiona::control::Change;
using fiona::control::JournalEntries;
using fiona::control::JournalEntry;
using fiona::host::Journal;

void apply(const std::vector<Change>& changes) {
  static const fiona::host::Packages none{"/nonexistent"};
  fiona::host::Model model;
  for (const auto& change : changes) {
    try {
      model.make(change, none);
    } catch (const fiona::Error& error) {
      if (error.text().what.empty()) std::abort();
    }
  }
}

/// How many changes there are once the records up to here are whole.
std::size_t changes_of(const JournalEntries& entries, int count) {
  std::map<std::uint64_t, const JournalEntry*> last;
  for (int i = 0; i < count; ++i) last[entries.entries(i).number()] = &entries.entries(i);
  std::size_t changes = 0;
  for (const auto& [number, entry] : last) {
    if (entry->state() == JournalEntry::DONE || entry->state() == JournalEntry::UNDONE)
      changes += static_cast<std::size_t>(entry->steps_size());
  }
  return changes;
}

/// Cut anywhere, or with one byte changed, what lies before it is read and nothing behind it.
void break_off(const JournalEntries& entries, std::size_t by) {
  std::string bytes;
  std::vector<std::size_t> ends{0};
  for (const auto& entry : entries.entries()) ends.push_back((bytes += Journal::record_of(entry)).size());
  if (bytes.empty()) return;
  const std::size_t cut = by % bytes.size();
  int whole = 0;
  while (ends[static_cast<std::size_t>(whole) + 1] <= cut) ++whole;
  if (Journal::told_by(std::string_view(bytes).substr(0, cut)).changes.size() != changes_of(entries, whole))
    std::abort();
  bytes[cut] = static_cast<char>(bytes[cut] ^ 1);
  if (Journal::told_by(bytes).changes.size() != changes_of(entries, whole)) std::abort();
}

}  // namespace

// The bytes of a journal; and JournalEntries, of which one is made.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto kLogBefore = google::protobuf::SetLogHandler(nullptr);
  static_cast<void>(kLogBefore);
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  apply(Journal::told_by(bytes).changes);
  JournalEntries entries;
  if (!entries.ParseFromArray(data, static_cast<int>(size))) return 0;
  std::size_t hash = size;
  for (const char byte : bytes) hash = hash * 31 + static_cast<unsigned char>(byte);
  break_off(entries, hash);
  std::vector<Change> all;
  for (const auto& entry : entries.entries()) all.insert(all.end(), entry.steps().begin(), entry.steps().end());
  apply(all);
  return 0;
}
