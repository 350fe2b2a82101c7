// Fails on purpose, on an input that is not in its corpus but near, and takes too much for two others: a driver that
// passes it does not look.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <string_view>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view input(reinterpret_cast<const char*>(data), size);
  if (std::count(input.begin(), input.end(), '"') == 3) std::abort();
  if (input.starts_with("time")) {
    for (const std::clock_t begin = std::clock(); std::clock() - begin < 1.2 * CLOCKS_PER_SEC;) continue;
  }
  if (input.starts_with("memory")) return std::vector<char>(300 << 20, 'm')[size] == 'n';
  return 0;
}
