#include <unistd.h>

#include "animal.hpp"

namespace {

int wait() {
  while (zoo::for_ever) ::pause();
  return 0;
}
[[maybe_unused]] const int waited = wait();

}  // namespace
