#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "fiona/control.pb.h"
#include "model.hpp"
#include "os/descriptor.hpp"

namespace fiona::host {

/// What was changed, by whom, and what takes it back: in memory for `undo`, and in a file that outlives the process.
///
/// A record is written before the step that it tells of and reaches the disk within a second, off the path of whoever
/// changes the system. Record: the length of the entry in 4 bytes and the first 4 bytes of its BLAKE2b hash, both
/// little endian, then the JournalEntry; a later record of the same number replaces an earlier one. The first record is
/// an entry without number, so that an empty file is no journal. Reading ends at the first record that is not whole.
class Journal {
 public:
  /// Entries that are kept for `undo`; older ones are folded into one that builds the system as it was after them.
  static constexpr std::size_t kMaxEntries = 1000;

  /// What a journal tells.
  struct Told {
    std::vector<control::JournalEntry> entries{};  ///< each as it was written last, in the order of these records
    std::vector<control::Change> changes{};        ///< give the system back; what was under way counts as not begun
    std::size_t bytes = 0;                         ///< of whole records
    std::size_t damaged = 0;                       ///< behind them, which cannot be read
    std::int64_t last_ms = 0;  ///< when the last change was begun that can be read, since 1970; 0: none
    bool older = false;        ///< of the one that was set aside: of the newest nothing can be read
  };

  /// Begins anew in FILE, or goes on with what was told by the journal there. What was there is set aside: as FILE.old,
  /// and where it was damaged as FILE.damaged. Without a file it is kept in memory only. At each moment there is a
  /// whole journal in FILE. Throws Error Failed.
  explicit Journal(std::filesystem::path file, std::optional<Told> before = std::nullopt);
  ~Journal();
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  /// Numbers the entry and writes it as under way. Throws Error: Failed when it cannot be written, NotAllowed when it
  /// would be too large to be read again. Then nothing is begun.
  std::uint64_t begin(control::JournalEntry entry);
  /// What takes the entry back is known only by now; written with its end.
  void set_reverse(std::uint64_t number, const std::vector<control::Change>& reverse);
  /// Writes how the entry of this number ended. `whole`: the system as it is meant to be from here on, which takes the
  /// place of a file that has grown; null: it has in it what another entry has made so far.
  void end(std::uint64_t number, control::JournalEntry::State state, const std::string& reason, const Model* whole);
  /// What `undo` takes back: the newest that is done, changed something, and has not been taken back or is about to be.
  const control::JournalEntry* last_done() const;
  const std::deque<control::JournalEntry>& entries() const { return entries_; }

  /// That in FILE; if nothing of that can be read, that in FILE.old. Throws Error NotFound if there is no such file,
  /// and Failed if nothing can be read of either.
  static Told read(const std::filesystem::path& file);
  /// The same of the bytes of one.
  static Told told_by(std::string_view bytes);
  static std::string record_of(const control::JournalEntry& entry);

 private:
  control::JournalEntry* find(std::uint64_t number);
  void write(const control::JournalEntry& entry);
  void replace(const std::string& records, const char* set_aside);
  void fold(const Model& whole);
  void sync_until_closed();

  const std::filesystem::path file_;
  os::Descriptor descriptor_;
  std::deque<control::JournalEntry> entries_;
  std::uint64_t next_number_ = 1;
  std::uint64_t written_bytes_ = 0;
  std::string owed_;  ///< records of what has ended that could not be written: they go before the next one

  std::mutex mutex_;
  std::condition_variable wake_;
  bool dirty_ = false;
  bool closed_ = false;
  std::thread syncer_;
};

}  // namespace fiona::host
