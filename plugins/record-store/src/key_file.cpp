#include "key_file.hpp"

#include <fcntl.h>
#include <sodium.h>
#include <unistd.h>

#include <cstring>
#include <fstream>

#include "fiona/error.hpp"

namespace fiona::records {
namespace {

[[noreturn]] void fail(const std::filesystem::path& file, const char* what) {
  throw Error(ErrorCode::Failed, {.what = std::string(what) + ": " + std::strerror(errno),
                                  .where = file.string(),
                                  .next = "make its folder one that this user may write to, and that has room"});
}

/// A descriptor that is closed.
struct File {
  explicit File(int number_) : number(number_) {}
  File(const File&) = delete;
  File& operator=(const File&) = delete;
  ~File() {
    if (number >= 0) ::close(number);
  }
  int number;
};

void sync_directory(const std::filesystem::path& of) {
  const File directory(::open(of.parent_path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (directory.number < 0 || ::fsync(directory.number) != 0) fail(of, "the key of the database cannot be written");
}

}  // namespace

Key read_key(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  Key key;
  in.read(reinterpret_cast<char*>(key.data()), key.size());
  if (!in || in.peek() != std::ifstream::traits_type::eof()) {
    throw Error(ErrorCode::Failed, {.what = "the key of the database is missing or damaged",
                                    .where = file.string(),
                                    .expected = std::to_string(key.size()) + " bytes, as they were made with it",
                                    .next = "bring the file back from a backup; without it no record can be trusted"});
  }
  return key;
}

Key make_key(const std::filesystem::path& file) {
  Key key;
  randombytes_buf(key.data(), key.size());
  const std::filesystem::path next = file.string() + ".next";
  ::unlink(next.c_str());
  const File made(::open(next.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600));
  if (made.number < 0) fail(next, "the key of the database cannot be made");
  if (::write(made.number, key.data(), key.size()) != static_cast<ssize_t>(key.size()) || ::fsync(made.number) != 0) {
    fail(next, "the key of the database cannot be written");
  }
  sync_directory(file);
  return key;
}

void adopt_key(const std::filesystem::path& file) {
  // Another process that opens the database at the same time may have done it.
  if (::rename((file.string() + ".next").c_str(), file.c_str()) != 0 && errno != ENOENT) {
    fail(file, "the key of the database cannot be written");
  }
  sync_directory(file);
}

}  // namespace fiona::records
