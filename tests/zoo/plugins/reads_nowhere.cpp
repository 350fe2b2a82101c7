#include "animal.hpp"

void zoo::act() {
  int* volatile nowhere = nullptr;
  *nowhere = 1;
}
