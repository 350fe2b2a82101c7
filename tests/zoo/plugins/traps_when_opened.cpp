#include "animal.hpp"

namespace {

int trap() {
  int* volatile nowhere = nullptr;
  return *nowhere;
}
[[maybe_unused]] const int trapped = trap();

}  // namespace
