#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>

namespace fiona::beacon_server {

/// What a beacon says of itself.
struct Identity {
  std::string uuid;  ///< lower-case 8-4-4-4-12; of an Eddystone the namespace (10 bytes) and the instance (6)
  std::uint16_t major = 0, minor = 0;  ///< of an Eddystone 0
  int measured_power_dbm = 0;          ///< what a receiver hears at 1 m

  bool operator==(const Identity&) const = default;
};

inline constexpr std::uint16_t kApple = 0x004C;  ///< company under which iBeacons are found in manufacturer data
inline constexpr const char* kEddystone = "0000feaa-0000-1000-8000-00805f9b34fb";  ///< its service data's UUID

/// Manufacturer data of the company 0x004C: an iBeacon, or nothing (Apple's devices say much else there). Source:
/// Apple, "Proximity Beacon Specification" R1: type 2, length 21, UUID, major, minor (big-endian), power at 1 m.
std::optional<Identity> parse_ibeacon(std::span<const std::uint8_t> data);

/// Service data of 0xFEAA: an Eddystone-UID frame, or nothing (URL, TLM and EID frames are none). Source: Google,
/// Eddystone protocol specification: frame type 0, power at 0 m, namespace, instance, two reserved bytes that may lack.
std::optional<Identity> parse_eddystone_uid(std::span<const std::uint8_t> data);

/// The beacon in the advertising data of one packet, a sequence of AD structures (Bluetooth Core 5.3, volume 3, part C,
/// 11): what BlueZ takes apart for who asks it, for who reads a radio himself. Structures that overrun the end are
/// none.
std::optional<Identity> parse_advertising_data(std::span<const std::uint8_t> data);

}  // namespace fiona::beacon_server
