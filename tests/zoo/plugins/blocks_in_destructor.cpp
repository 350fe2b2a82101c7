#include <unistd.h>

#include "animal.hpp"

void zoo::destroy() {
  while (for_ever) ::pause();
}
