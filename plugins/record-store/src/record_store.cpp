#include "fiona/records/record_store.hpp"

#include <fcntl.h>
#include <sodium.h>
#include <sqlite3.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <system_error>
#include <vector>

#include "fiona/error.hpp"
#include "key_file.hpp"

namespace fiona::records {
namespace {

constexpr std::size_t kSealBytes = crypto_generichash_BYTES;
constexpr int kWaitForOthers_ms = 2000;
constexpr const char* kSchema =
    "CREATE TABLE about(kind TEXT NOT NULL) STRICT;"
    "CREATE TABLE seal(list TEXT PRIMARY KEY, seal BLOB NOT NULL) STRICT, WITHOUT ROWID;"
    "CREATE TABLE record(list TEXT, name TEXT, value BLOB NOT NULL, seal BLOB NOT NULL, PRIMARY KEY(list, name)) "
    "STRICT, WITHOUT ROWID;";

std::string joined(const std::string& a, const std::string& b) {
  std::string sum(kSealBytes, '\0');
  for (std::size_t i = 0; i < kSealBytes; ++i) sum[i] = static_cast<char>(a.at(i) ^ b.at(i));
  return sum;
}

bool equal(const std::string& a, const std::string& b) {
  return a.size() == b.size() && sodium_memcmp(a.data(), b.data(), a.size()) == 0;
}

/// SQLite would make it readable for whoever the umask lets read.
void make_private(const std::filesystem::path& file) {
  const int made = ::open(file.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
  if (made < 0) {
    throw Error(ErrorCode::Failed, {.what = std::string("the database cannot be opened: ") + std::strerror(errno),
                                    .where = file.string(),
                                    .next = "make its folder one that this user may write to, and that has room"});
  }
  ::close(made);
}

}  // namespace

struct RecordStore::Database {
  ~Database() { sqlite3_close(handle); }
  sqlite3* handle = nullptr;
  Key key{};
};

/// One prepared statement, in the store's mutex.
class RecordStore::Statement {
 public:
  Statement(const RecordStore& store, const char* sql) : store_(store) {
    if (sqlite3_prepare_v2(store.database_->handle, sql, -1, &handle_, nullptr) != SQLITE_OK) store_.fail("");
  }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;
  ~Statement() { sqlite3_finalize(handle_); }

  Statement& text(int index, std::string_view value) {
    sqlite3_bind_text(handle_, index, value.data(), static_cast<int>(value.size()), SQLITE_TRANSIENT);
    return *this;
  }
  Statement& blob(int index, std::string_view value) {
    // An empty view has no address, and SQLite takes that for NULL.
    sqlite3_bind_blob(handle_, index, value.empty() ? "" : value.data(), static_cast<int>(value.size()),
                      SQLITE_TRANSIENT);
    return *this;
  }
  /// Whether there is a row.
  bool step() {
    const int result = sqlite3_step(handle_);
    if (result != SQLITE_ROW && result != SQLITE_DONE) store_.fail("");
    return result == SQLITE_ROW;
  }
  std::string column(int index) const {
    const auto* bytes = static_cast<const char*>(sqlite3_column_blob(handle_, index));
    return {bytes ? bytes : "", static_cast<std::size_t>(sqlite3_column_bytes(handle_, index))};
  }

 private:
  const RecordStore& store_;
  sqlite3_stmt* handle_ = nullptr;
};

/// Rolled back unless it is committed.
class RecordStore::Transaction {
 public:
  explicit Transaction(const RecordStore& store) : store_(store) { store_.run("BEGIN IMMEDIATE"); }
  Transaction(const Transaction&) = delete;
  Transaction& operator=(const Transaction&) = delete;
  ~Transaction() {
    if (!done_) sqlite3_exec(store_.database_->handle, "ROLLBACK", nullptr, nullptr, nullptr);
  }
  void commit() {
    store_.run("COMMIT");
    done_ = true;
  }

 private:
  const RecordStore& store_;
  bool done_ = false;
};

RecordStore::RecordStore(const std::filesystem::path& file, std::string_view kind)
    : file_(std::filesystem::absolute(file)), database_(std::make_unique<Database>()) {
  if (sodium_init() < 0)
    throw Error(ErrorCode::Failed, {.what = "libsodium could not be initialised", .next = "doctor"});
  std::error_code ignored;
  if (std::filesystem::create_directories(file_.parent_path(), ignored)) {
    std::filesystem::permissions(file_.parent_path(), std::filesystem::perms::owner_all, ignored);
  }
  make_private(file_);
  if (sqlite3_open_v2(file_.c_str(), &database_->handle, SQLITE_OPEN_READWRITE | SQLITE_OPEN_NOFOLLOW, nullptr) !=
      SQLITE_OK) {
    fail("");
  }
  sqlite3_busy_timeout(database_->handle, kWaitForOthers_ms);
  sqlite3_db_config(database_->handle, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  run("PRAGMA trusted_schema=OFF; PRAGMA cell_size_check=ON; PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL");
  const std::filesystem::path key = file_.string() + ".key";
  if (!is_made() && std::filesystem::exists(key, ignored)) {
    fail("the database is empty or missing, and its key says that it was not",
         "bring " + file_.string() + " back from a backup; to begin anew remove " + key.string());
  }
  if (!is_made()) make(kind, key);
  // Whoever made it may have died before the key had its name.
  if (!std::filesystem::exists(key, ignored)) adopt_key(key);
  database_->key = read_key(key);
  check();
  Statement about(*this, "SELECT kind FROM about");
  if (const std::string found = about.step() ? about.column(0) : ""; found != kind) {
    throw Error(ErrorCode::Failed, {.what = "the database holds something else",
                                    .where = file_.string(),
                                    .expected = std::string(kind),
                                    .found = found});
  }
}

bool RecordStore::is_made() const { return Statement(*this, "SELECT 1 FROM sqlite_schema").step(); }

/// The key is on the disk before the database is, and has its name after it.
void RecordStore::make(std::string_view kind, const std::filesystem::path& key) {
  Transaction making(*this);
  if (is_made()) return;  // another process was faster
  make_key(key);
  run(kSchema);
  Statement(*this, "INSERT INTO about VALUES(?1)").text(1, kind).step();
  making.commit();
}

RecordStore::~RecordStore() { sodium_memzero(database_->key.data(), database_->key.size()); }

void RecordStore::fail(std::string what, std::string next) const {
  const int code = database_->handle ? sqlite3_errcode(database_->handle) : SQLITE_OK;
  if (what.empty()) {
    const bool damaged = code == SQLITE_CORRUPT || code == SQLITE_NOTADB || code == SQLITE_ERROR;
    what = std::string(damaged ? "the database is damaged: " : "the database cannot be used: ") +
           (database_->handle ? sqlite3_errmsg(database_->handle) : "out of memory");
    if (damaged) next = "bring it back from a backup, with its -wal file if there is one";
    if (code == SQLITE_FULL) next = "make room on the disk; nothing has been lost";
  }
  throw Error(ErrorCode::Failed, {.what = std::move(what), .where = file_.string(), .next = std::move(next)});
}

void RecordStore::run(const char* sql) const {
  if (sqlite3_exec(database_->handle, sql, nullptr, nullptr, nullptr) != SQLITE_OK) fail("");
}

std::string RecordStore::seal_of(std::string_view table, std::string_view name, std::string_view value) const {
  crypto_generichash_state state;
  crypto_generichash_init(&state, database_->key.data(), database_->key.size(), kSealBytes);
  for (const std::string_view part : {table, name, value}) {
    // The length first, so that no two lists of parts are the same bytes.
    const std::uint64_t size = part.size();
    crypto_generichash_update(&state, reinterpret_cast<const unsigned char*>(&size), sizeof(size));
    crypto_generichash_update(&state, reinterpret_cast<const unsigned char*>(part.data()), part.size());
  }
  std::string seal(kSealBytes, '\0');
  crypto_generichash_final(&state, reinterpret_cast<unsigned char*>(seal.data()), seal.size());
  return seal;
}

std::string RecordStore::table_seal(std::string_view table) const {
  Statement query(*this, "SELECT seal FROM seal WHERE list=?1");
  std::string seal = query.text(1, table).step() ? query.column(0) : std::string(kSealBytes, '\0');
  if (seal.size() != kSealBytes)
    fail("the seal of " + std::string(table) + " is damaged", "bring it back from a backup");
  return seal;
}

std::optional<std::string> RecordStore::read(std::string_view table, std::string_view name) const {
  Statement query(*this, "SELECT value, seal FROM record WHERE list=?1 AND name=?2");
  if (!query.text(1, table).text(2, name).step()) return std::nullopt;
  std::string value = query.column(0);
  if (!equal(query.column(1), seal_of(table, name, value))) {
    fail("the record of '" + std::string(name) + "' in " + std::string(table) + " is damaged",
         "bring " + file_.string() + " back from a backup");
  }
  return value;
}

std::optional<std::string> RecordStore::get(std::string_view table, std::string_view name) const {
  const std::lock_guard lock(mutex_);
  return read(table, name);
}

std::map<std::string, std::string> RecordStore::all(std::string_view table) const {
  const std::lock_guard lock(mutex_);
  std::map<std::string, std::string> found;
  run("BEGIN");  // one look at records and their seal
  try {
    std::string sum(kSealBytes, '\0');
    Statement query(*this, "SELECT name, value, seal FROM record WHERE list=?1");
    query.text(1, table);
    while (query.step()) {
      const std::string seal = query.column(2);
      std::string name = query.column(0);
      std::string value = query.column(1);
      if (!equal(seal, seal_of(table, name, value))) {
        fail("the record of '" + name + "' in " + std::string(table) + " is damaged",
             "bring " + file_.string() + " back from a backup");
      }
      sum = joined(sum, seal);
      found.emplace(std::move(name), std::move(value));
    }
    if (!equal(sum, table_seal(table))) {
      fail("records of " + std::string(table) + " are missing", "bring " + file_.string() + " back from a backup");
    }
  } catch (...) {
    sqlite3_exec(database_->handle, "ROLLBACK", nullptr, nullptr, nullptr);
    throw;
  }
  run("COMMIT");
  return found;
}

/// In a transaction.
void RecordStore::change(std::string_view table, std::string_view name, const std::string* value) {
  std::string sum = table_seal(table);
  if (const auto old = read(table, name)) sum = joined(sum, seal_of(table, name, *old));
  if (value) {
    const std::string seal = seal_of(table, name, *value);
    sum = joined(sum, seal);
    Statement put(*this, "INSERT OR REPLACE INTO record VALUES(?1, ?2, ?3, ?4)");
    put.text(1, table).text(2, name).blob(3, *value).blob(4, seal).step();
  } else {
    Statement erase(*this, "DELETE FROM record WHERE list=?1 AND name=?2");
    erase.text(1, table).text(2, name).step();
  }
  Statement(*this, "INSERT OR REPLACE INTO seal VALUES(?1, ?2)").text(1, table).blob(2, sum).step();
}

void RecordStore::put(std::string_view table, std::string_view name, std::string_view value) {
  const std::lock_guard lock(mutex_);
  Transaction changing(*this);
  const std::string bytes(value);
  change(table, name, &bytes);
  changing.commit();
}

bool RecordStore::exchange(std::string_view table, std::string_view name, const std::optional<std::string>& expected,
                           std::string_view value) {
  const std::lock_guard lock(mutex_);
  Transaction changing(*this);
  if (read(table, name) != expected) return false;
  const std::string bytes(value);
  change(table, name, &bytes);
  changing.commit();
  return true;
}

bool RecordStore::erase(std::string_view table, std::string_view name) {
  const std::lock_guard lock(mutex_);
  Transaction changing(*this);
  if (!read(table, name)) return false;
  change(table, name, nullptr);
  changing.commit();
  return true;
}

std::uint64_t RecordStore::version() const {
  const std::lock_guard lock(mutex_);
  Statement query(*this, "PRAGMA data_version");
  return query.step() ? std::stoull(query.column(0)) : 0;
}

void RecordStore::check() const {
  Statement pages(*this, "PRAGMA quick_check(1)");
  if (const std::string said = pages.step() ? pages.column(0) : "nothing"; said != "ok") {
    fail("the database is damaged: " + said, "bring it back from a backup, with its -wal file if there is one");
  }
  std::vector<std::string> tables;
  Statement lists(*this, "SELECT list FROM record UNION SELECT list FROM seal");
  while (lists.step()) tables.push_back(lists.column(0));
  for (const std::string& table : tables) all(table);
}

}  // namespace fiona::records
