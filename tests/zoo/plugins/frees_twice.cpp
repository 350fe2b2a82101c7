#include <cstdlib>

#include "animal.hpp"

void zoo::act() {
  void* volatile memory = std::malloc(2000);
  std::free(memory);
  std::free(memory);
}
