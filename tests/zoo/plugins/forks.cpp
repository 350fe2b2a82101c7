#include <unistd.h>

#include <stdexcept>

#include "animal.hpp"

void zoo::act() {
  for (int i = 0; i < 100; ++i) {
    const pid_t child = ::fork();
    if (child == 0) ::_exit(0);
    if (child < 0) throw std::runtime_error("it was given no process");
  }
  throw std::runtime_error("it was given all that it wanted");
}
