#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

namespace fiona::records {

/// Records by name in tables, in a file that survives power cuts and tells its damage.
///
/// A SQLite database in WAL mode, each change synced before it returns. SQLite notices a damaged page, but not a
/// flipped bit in a value: so each record is sealed with a keyed hash (BLAKE2b, RFC 7693, over table, name and value),
/// and each table with the exclusive or of its records' seals, that none can vanish. The key lies beside the database,
/// as FILE.key; a database without its key, or a key whose database is empty, is refused: what has been kept is never
/// silently taken for nothing. Seals tell damage, not an attacker who can read the key.
///
/// Several processes may have it open: who administers, and who serves. All functions [any thread]; they wait at most
/// 2 s for another process, and throw Error (Failed) for damage, a full disk, and whatever else SQLite says.
class RecordStore {
 public:
  /// Opens it, or makes it and the directories above it. `kind` says what it holds ("users"): another kind's is
  /// refused. All of it is checked.
  RecordStore(const std::filesystem::path& file, std::string_view kind);
  ~RecordStore();
  RecordStore(const RecordStore&) = delete;
  RecordStore& operator=(const RecordStore&) = delete;

  std::optional<std::string> get(std::string_view table, std::string_view name) const;
  /// All records of a table, by name.
  std::map<std::string, std::string> all(std::string_view table) const;
  /// Adds or replaces.
  void put(std::string_view table, std::string_view name, std::string_view value);
  /// Replaces `expected`, or adds where nothing is expected. False, and nothing has changed, if the record is another
  /// one meanwhile.
  bool exchange(std::string_view table, std::string_view name, const std::optional<std::string>& expected,
                std::string_view value);
  /// False if there was none.
  bool erase(std::string_view table, std::string_view name);

  /// Another number after another process has changed something.
  std::uint64_t version() const;

  const std::filesystem::path& file() const { return file_; }

 private:
  struct Database;
  class Statement;
  class Transaction;
  bool is_made() const;
  void make(std::string_view kind, const std::filesystem::path& key);
  void change(std::string_view table, std::string_view name, const std::string* value);
  std::optional<std::string> read(std::string_view table, std::string_view name) const;
  std::string seal_of(std::string_view table, std::string_view name, std::string_view value) const;
  std::string table_seal(std::string_view table) const;
  void check() const;
  void run(const char* sql) const;
  [[noreturn]] void fail(std::string what, std::string next = {}) const;

  const std::filesystem::path file_;
  mutable std::mutex mutex_;
  std::unique_ptr<Database> database_;
};

}  // namespace fiona::records
