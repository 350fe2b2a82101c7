#include "advertisement.hpp"

namespace fiona::beacon_server {
namespace {

constexpr std::uint8_t kProximity = 0x02, kProximityLength = 21;
constexpr std::size_t kUuidBytes = 16;
constexpr std::uint8_t kUidFrame = 0x00;
constexpr std::size_t kUidBytes = 18;
constexpr int kFirstMetre_db = 41;  // lost between 0 and 1 m, by the Eddystone specification
constexpr std::uint8_t kServiceData16 = 0x16, kManufacturerData = 0xFF;
constexpr std::uint16_t kEddystone16 = 0xFEAA;

std::string uuid_text(std::span<const std::uint8_t> bytes) {
  constexpr char kDigits[] = "0123456789abcdef";
  std::string text;
  for (std::size_t i = 0; i < kUuidBytes; ++i) {
    if (i == 4 || i == 6 || i == 8 || i == 10) text += '-';
    text += kDigits[bytes[i] >> 4];
    text += kDigits[bytes[i] & 15];
  }
  return text;
}

int signed_byte(std::uint8_t byte) { return static_cast<std::int8_t>(byte); }

std::uint16_t big_endian(std::span<const std::uint8_t> two) { return static_cast<std::uint16_t>(two[0] << 8 | two[1]); }
std::uint16_t little_endian(std::span<const std::uint8_t> two) {
  return static_cast<std::uint16_t>(two[1] << 8 | two[0]);
}

}  // namespace

std::optional<Identity> parse_ibeacon(std::span<const std::uint8_t> data) {
  if (data.size() != 2u + kProximityLength || data[0] != kProximity || data[1] != kProximityLength) return std::nullopt;
  return Identity{uuid_text(data.subspan(2)), big_endian(data.subspan(18)), big_endian(data.subspan(20)),
                  signed_byte(data[22])};
}

std::optional<Identity> parse_eddystone_uid(std::span<const std::uint8_t> data) {
  const bool with_reserved = data.size() == kUidBytes + 2;
  if ((data.size() != kUidBytes && !with_reserved) || data[0] != kUidFrame) return std::nullopt;
  return Identity{uuid_text(data.subspan(2)), 0, 0, signed_byte(data[1]) - kFirstMetre_db};
}

std::optional<Identity> parse_advertising_data(std::span<const std::uint8_t> data) {
  while (!data.empty()) {
    const std::size_t length = data[0];
    if (length == 0 || length >= data.size()) return std::nullopt;  // zeros fill the rest
    const std::uint8_t type = data[1];
    const auto value = data.subspan(2, length - 1);
    data = data.subspan(length + 1);
    if (value.size() < 2) continue;
    std::optional<Identity> found;
    if (type == kManufacturerData && little_endian(value) == kApple) found = parse_ibeacon(value.subspan(2));
    if (type == kServiceData16 && little_endian(value) == kEddystone16) found = parse_eddystone_uid(value.subspan(2));
    if (found) return found;
  }
  return std::nullopt;
}

}  // namespace fiona::beacon_server
