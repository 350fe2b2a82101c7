// Fails on purpose, on an input that is not in its corpus but near: a driver that passes it does not look.
#include <algorithm>
#include <cstdint>
#include <cstdlib>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (std::count(data, data + size, std::uint8_t{'"'}) == 3) std::abort();
  return 0;
}
