#include <fcntl.h>

#include "animal.hpp"

/// More than it may have, and fewer than the kernel would refuse it.
void zoo::act() {
  for (int i = 0; i < 190; ++i) ::open("/dev/null", O_RDONLY);
}
