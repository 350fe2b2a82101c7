// Payloads of advertisements, which anyone within range of the radio may send.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "advertisement.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace fiona::beacon_server;
  const std::span<const std::uint8_t> bytes(data, size);
  for (const auto& found : {parse_ibeacon(bytes), parse_eddystone_uid(bytes), parse_advertising_data(bytes)}) {
    if (found && (found->uuid.size() != 36 || found->measured_power_dbm < -169 || found->measured_power_dbm > 127))
      std::abort();
  }
  return 0;
}
