#include <stdexcept>
#include <vector>

#include "animal.hpp"

void zoo::act() {
  const std::vector<char> much(std::size_t{4} << 30U, 'x');
  throw std::runtime_error("it was given all that it wanted");
}
