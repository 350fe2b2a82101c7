#pragma once

#include <cstddef>

#include "os/descriptor.hpp"

namespace fiona::os {

/// Memory that this process shares with a child. Nobody can make it smaller: whoever reads it need not trust the other.
class SharedMemory {
 public:
  /// All zero. Throws Error if the system has none.
  explicit SharedMemory(std::size_t bytes);
  /// That of another process, which has given us this descriptor.
  SharedMemory(Descriptor descriptor, std::size_t bytes);
  ~SharedMemory();
  SharedMemory(const SharedMemory&) = delete;
  SharedMemory& operator=(const SharedMemory&) = delete;

  void* data() const { return data_; }
  int descriptor() const { return descriptor_.get(); }

 private:
  void map();

  Descriptor descriptor_;
  const std::size_t bytes_;
  void* data_ = nullptr;
};

}  // namespace fiona::os
