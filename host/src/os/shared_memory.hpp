#pragma once

#include <sys/types.h>

#include <cstddef>

#include "os/descriptor.hpp"

namespace fiona::os {

/// Memory that this process shares with another. Nobody can make it smaller: what is read is there.
class SharedMemory {
 public:
  /// All zero. Throws Error if the system has none.
  explicit SharedMemory(std::size_t bytes);
  /// That of another process, which has given us this descriptor.
  SharedMemory(Descriptor descriptor, std::size_t bytes);
  /// That of another process of this machine and user, whose descriptor it is there: to be read. Throws Error if it
  /// is not reached, is no such memory, or is of another size.
  SharedMemory(pid_t process, int descriptor, std::size_t bytes);
  ~SharedMemory();
  SharedMemory(const SharedMemory&) = delete;
  SharedMemory& operator=(const SharedMemory&) = delete;

  void* data() const { return data_; }
  int descriptor() const { return descriptor_.get(); }
  /// Whether so many bytes from the begin of the page `from` can be written: where the machine has no memory left for
  /// them, whoever does is ended by a signal.
  bool reserve(std::size_t from, std::size_t bytes) const;
  /// Whoever is to have the memory has it.
  void forget_descriptor() { descriptor_.reset(); }

 private:
  void map(int access);

  Descriptor descriptor_;
  const std::size_t bytes_;
  void* data_ = nullptr;
};

}  // namespace fiona::os
