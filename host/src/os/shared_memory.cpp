#include "os/shared_memory.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include <cerrno>
#include <cstring>
#include <string>

#include "fiona/error.hpp"

namespace fiona::os {

SharedMemory::SharedMemory(std::size_t bytes)
    : descriptor_(::memfd_create("fiona", MFD_CLOEXEC | MFD_ALLOW_SEALING)), bytes_(bytes) {
  const bool made = descriptor_ && ::ftruncate(descriptor_.get(), static_cast<off_t>(bytes)) == 0 &&
                    ::fcntl(descriptor_.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) == 0;
  if (!made) {
    throw Error(ErrorCode::Failed, {.what = "the system gives no memory that can be shared",
                                    .found = std::strerror(errno),
                                    .next = "free memory, or raise the limit of descriptors: ulimit -n"});
  }
  map(PROT_READ | PROT_WRITE);
}

SharedMemory::SharedMemory(Descriptor descriptor, std::size_t bytes)
    : descriptor_(std::move(descriptor)), bytes_(bytes) {
  map(PROT_READ | PROT_WRITE);
}

SharedMemory::SharedMemory(pid_t process, int descriptor, std::size_t bytes) : bytes_(bytes) {
  const std::string path = "/proc/" + std::to_string(process) + "/fd/" + std::to_string(descriptor);
  descriptor_ = Descriptor(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  struct stat found {};
  const int seals = descriptor_ ? ::fcntl(descriptor_.get(), F_GET_SEALS) : -1;
  const bool is_memory = seals >= 0 && (seals & F_SEAL_SHRINK) != 0 && ::fstat(descriptor_.get(), &found) == 0 &&
                         static_cast<std::size_t>(found.st_size) == bytes;
  if (!is_memory) {
    throw Error(ErrorCode::Failed, {.what = "another process' memory is not reached",
                                    .where = path,
                                    .expected = std::to_string(bytes) + " bytes that cannot become fewer",
                                    .found = descriptor_ ? "something else" : std::strerror(errno)});
  }
  map(PROT_READ);
  forget_descriptor();
}

void SharedMemory::map(int access) {
  void* const mapped = ::mmap(nullptr, bytes_, access, MAP_SHARED, descriptor_.get(), 0);
  if (mapped == MAP_FAILED) {
    throw Error(
        ErrorCode::Failed,
        {.what = "shared memory cannot be mapped", .found = std::strerror(errno), .next = "free memory: free -m"});
  }
  data_ = mapped;
}

bool SharedMemory::reserve(std::size_t from, std::size_t bytes) const {
  // A kernel before 5.14 does not know it: there it is as before.
  return ::madvise(static_cast<char*>(data_) + from, bytes, MADV_POPULATE_WRITE) == 0 || errno == EINVAL;
}

SharedMemory::~SharedMemory() {
  if (data_) ::munmap(data_, bytes_);
}

}  // namespace fiona::os
