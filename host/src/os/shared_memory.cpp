#include "os/shared_memory.hpp"

#include <fcntl.h>
#include <sys/mman.h>

#include <cerrno>
#include <cstring>

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
  map();
}

SharedMemory::SharedMemory(Descriptor descriptor, std::size_t bytes)
    : descriptor_(std::move(descriptor)), bytes_(bytes) {
  map();
}

void SharedMemory::map() {
  void* const mapped = ::mmap(nullptr, bytes_, PROT_READ | PROT_WRITE, MAP_SHARED, descriptor_.get(), 0);
  if (mapped == MAP_FAILED) {
    throw Error(
        ErrorCode::Failed,
        {.what = "shared memory cannot be mapped", .found = std::strerror(errno), .next = "free memory: free -m"});
  }
  data_ = mapped;
}

SharedMemory::~SharedMemory() {
  if (data_) ::munmap(data_, bytes_);
}

}  // namespace fiona::os
