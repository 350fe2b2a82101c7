// The bytes of radio maps: any bytes give a map or one fiona::Error, and a map can be used and saved. The header with
// its checksum is made to fit, so that what is behind it is reached.
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include <fiona/error.hpp>

#include "radio_filter.hpp"
#include "radio_map_file.hpp"

namespace {

constexpr std::size_t kMostUsedCells = 2000;

void append(std::string& bytes, std::uint64_t value, int count) {
  for (int i = 0; i < count; ++i) bytes.push_back(static_cast<char>((value >> (8 * i)) & 0xFF));
}

std::string with_header(std::string_view payload) {
  std::uint64_t checksum = 0xCBF29CE484222325ull;
  for (const char c : payload) checksum = (checksum ^ static_cast<unsigned char>(c)) * 0x100000001B3ull;
  std::string bytes = "FIONARM\n";
  append(bytes, fiona::radio::kRadioMapVersion, 4);
  append(bytes, payload.size(), 8);
  append(bytes, checksum, 8);
  return bytes.append(payload);
}

void use(fiona::radio::RadioMap map) {
  if (map.cells.size() > kMostUsedCells) return;
  const auto shared = std::make_shared<const fiona::radio::RadioMap>(std::move(map));
  fiona::radio::FilterOptions options;
  options.particles = 20;
  fiona::radio::RadioFilter filter(shared, options);
  for (int t_ms = 1000; t_ms <= 3000; t_ms += 1000) {
    const fiona::radio::Time time(t_ms);
    for (const auto& transmitter : shared->transmitters)
      filter.signal(time, {transmitter.id, transmitter.radio, -60.0, time});
    filter.step({time, 0.7, 0.1, 0.0, 0.1});
    filter.advance(time + fiona::radio::Time(500));
    filter.estimate();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  for (const std::string& file : {std::string(bytes), with_header(bytes)}) {
    try {
      use(fiona::radio::parse(file, "fuzz"));
    } catch (const fiona::Error&) {
    }
  }
  return 0;
}
