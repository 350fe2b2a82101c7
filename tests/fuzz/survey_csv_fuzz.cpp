// Surveys and tracks of beacons as rows of text: any bytes give seconds whose values can be used, or one fiona::Error.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <sstream>
#include <string>

#include "fiona/error.hpp"
#include "survey_csv.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  try {
    std::istringstream stream(bytes);
    for (const auto& second : fiona::beacons::read_survey(stream, "fuzzed")) {
      if (!(std::abs(second.x_m) <= 1e4 && std::abs(second.y_m) <= 1e4) || std::abs(second.level) > 1000) std::abort();
    }
  } catch (const fiona::Error& error) {
    if (error.text().what.empty()) std::abort();
  }
  try {
    std::istringstream stream(bytes);
    for (const auto& row : fiona::beacons::read_tracks(stream, "fuzzed")) {
      if (!std::isfinite(row.rssi_dbm)) std::abort();
    }
  } catch (const fiona::Error& error) {
    if (error.text().what.empty()) std::abort();
  }
  return 0;
}
