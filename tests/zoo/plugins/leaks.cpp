#include <stdexcept>
#include <vector>

#include "animal.hpp"

void zoo::act() {
  std::vector<std::vector<char>> leak;
  while (leak.size() < 4 * 1024) leak.emplace_back(1024 * 1024, 'x');
  throw std::runtime_error("it was given all that it wanted");
}
