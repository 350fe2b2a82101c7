#include "sealed_library.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <string_view>

#include "fiona/error.hpp"
#include "fiona/marketplace/hash.hpp"

namespace fiona::host {
namespace {

[[noreturn]] void refuse(const wire::LibraryFile& file, ErrorText text) {
  text.what = "a library of " + file.package() + " is not the one that was installed: " + text.what;
  text.where = file.path();
  text.next = "market verify; market install " + file.package() + " brings it back";
  throw Error(ErrorCode::BadSignature, std::move(text));
}

[[noreturn]] void fail(const std::string& what, const std::string& where) {
  throw Error(ErrorCode::Failed,
              {.what = what,
               .where = where,
               .found = std::strerror(errno),
               .next = "see whether memory is left and the file may be read: free -m; ls -l " + where});
}

void write_all(int to, std::string_view bytes, const std::string& where) {
  while (!bytes.empty()) {
    const ssize_t count = ::write(to, bytes.data(), bytes.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) fail("a library cannot be copied into memory", where);
    bytes.remove_prefix(static_cast<std::size_t>(count));
  }
}

/// Copies at most as many bytes as it was installed with, and one more that tells that there are more.
std::string copied_hash(const os::Descriptor& from, const os::Descriptor& to, const wire::LibraryFile& file) {
  marketplace::Blake2b hash;
  std::array<char, 1 << 16> buffer;
  std::uint64_t left = file.size() + 1;
  while (left > 0) {
    const ssize_t count = ::read(from.get(), buffer.data(), std::min<std::uint64_t>(buffer.size(), left));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) refuse(file, {.what = "it cannot be read", .found = std::strerror(errno)});
    if (count == 0) break;
    const std::string_view piece(buffer.data(), static_cast<std::size_t>(count));
    hash.update(piece);
    write_all(to.get(), piece, file.path());
    left -= piece.size();
  }
  return hash.finish();
}

}  // namespace

SealedLibrary::SealedLibrary(const wire::LibraryFile& file)
    : memory_(::memfd_create("fiona-library", MFD_CLOEXEC | MFD_ALLOW_SEALING)) {
  if (!memory_) fail("the system gives no memory for a library", file.path());
  const os::Descriptor source(::open(file.path().c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
  if (!source) refuse(file, {.what = "it cannot be opened", .found = std::strerror(errno)});
  const std::string found = copied_hash(source, memory_, file);
  if (found != file.blake2b()) refuse(file, {.what = "other content", .expected = file.blake2b(), .found = found});
  if (::fcntl(memory_.get(), F_ADD_SEALS, F_SEAL_WRITE | F_SEAL_GROW | F_SEAL_SHRINK | F_SEAL_SEAL) != 0) {
    fail("a library cannot be sealed", file.path());
  }
}

void SealedLibrary::write_to(const std::filesystem::path& path) const {
  const os::Descriptor file(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0444));
  struct stat status {};
  if (!file || ::fstat(memory_.get(), &status) != 0) fail("a library cannot be copied into a sandbox", path);
  off_t offset = 0;
  while (offset < status.st_size) {
    const ssize_t count =
        ::sendfile(file.get(), memory_.get(), &offset, static_cast<std::size_t>(status.st_size - offset));
    if (count <= 0 && errno != EINTR) fail("a library cannot be copied into a sandbox", path);
  }
}

}  // namespace fiona::host
