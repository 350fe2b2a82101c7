#include <thread>

#include "animal.hpp"

void zoo::act() {
  const auto spin = [] {
    while (for_ever) continue;
  };
  for (int i = 0; i < 2; ++i) std::thread(spin).detach();
}
