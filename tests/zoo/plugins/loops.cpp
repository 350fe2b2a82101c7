#include "animal.hpp"

void zoo::act() {
  while (for_ever) continue;
}
