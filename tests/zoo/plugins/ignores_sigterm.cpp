#include <signal.h>
#include <unistd.h>

#include "animal.hpp"

void zoo::act() {
  ::signal(SIGTERM, SIG_IGN);
  ::raise(SIGTERM);
  while (for_ever) ::pause();
}
