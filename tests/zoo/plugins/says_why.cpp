#include <cstdlib>
#include <iostream>

#include "animal.hpp"

void zoo::act() {
  std::cerr << "the lens is dirty\ncannot go on" << std::endl;
  std::abort();
}
