#include <stdexcept>
#include <string>

#include "animal.hpp"

void zoo::act() {
  const std::string line(1000, 'x');
  for (int i = 0; i < 100'000; ++i) log(line.c_str());
  throw std::runtime_error("it has said all");
}
