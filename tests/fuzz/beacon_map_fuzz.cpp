// Beacon maps as text: refused with a sentence, or one that a field can be made of.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "beacon_map.hpp"
#include "fiona/error.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    fiona::beacons::parse({reinterpret_cast<const char*>(data), size}, "fuzzed");
  } catch (const fiona::Error&) {
  }
  return 0;
}
