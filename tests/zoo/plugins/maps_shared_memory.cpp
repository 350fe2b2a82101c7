#include <sys/mman.h>

#include <cstring>
#include <stdexcept>

#include "animal.hpp"

/// Memory that no count of a process' own data has.
void zoo::act() {
  constexpr std::size_t kStep = 16 * 1024 * 1024;
  for (int i = 0; i < 256; ++i) {
    void* const more = ::mmap(nullptr, kStep, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (more == MAP_FAILED) throw std::runtime_error("it was given no more memory");
    std::memset(more, 'x', kStep);
  }
  throw std::runtime_error("it was given all that it wanted");
}
