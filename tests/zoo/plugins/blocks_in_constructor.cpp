#include <unistd.h>

#include "animal.hpp"

void zoo::construct() {
  while (for_ever) ::pause();
}
