#include <stdexcept>

#include "animal.hpp"

namespace {

int fail() { throw std::runtime_error("a static constructor throws"); }
[[maybe_unused]] const int failed = fail();

}  // namespace
