#include "animal.hpp"

namespace {

int deeper(volatile int* above) {
  volatile int here[1024] = {above ? above[0] : 0};
  return zoo::for_ever ? deeper(here) + here[1] : 0;
}

}  // namespace

void zoo::act() { deeper(nullptr); }
