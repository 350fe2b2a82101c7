#include <sys/mman.h>

#include <stdexcept>

#include "animal.hpp"

/// Memory that no count of a process' own data has, all of it at once: it is not to be found hanging before.
void zoo::act() {
  constexpr std::size_t kStep = 16 * 1024 * 1024;
  constexpr int kFlags = MAP_SHARED | MAP_ANONYMOUS | MAP_POPULATE;
  for (int i = 0; i < 256; ++i) {
    void* const more = ::mmap(nullptr, kStep, PROT_READ | PROT_WRITE, kFlags, -1, 0);
    if (more == MAP_FAILED) throw std::runtime_error("it was given no more memory");
  }
  throw std::runtime_error("it was given all that it wanted");
}
