#include <fcntl.h>

#include <stdexcept>

#include "animal.hpp"

void zoo::act() {
  for (int i = 0; i < 100'000; ++i) {
    if (::open("/dev/null", O_RDONLY) < 0) throw std::runtime_error("it was given no more descriptors");
  }
  throw std::runtime_error("it was given all that it wanted");
}
