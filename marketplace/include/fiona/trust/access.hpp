#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace fiona::trust {

/// What somebody may do with a host, from 0 (nothing) to 9 (everything). A level includes those below it; what needs
/// which is said in host/src/access.cpp.
enum class Access : std::uint8_t {
  Nothing = 0,
  Observe = 1,     ///< sees what runs
  Operate = 4,     ///< changes modes and parameters, calls
  Compose = 6,     ///< loads, wires
  Administer = 9,  ///< ends the host, names files on its machine
  Nobody = 10,     ///< what has no level: more than anybody has
};

/// "operate"; "5" where the level has no name.
std::string access_name(Access access);
/// "operate (4)".
std::string access_text(Access access);
/// "observe", "operate", "compose" or "administer"; nothing for any other word.
std::optional<Access> access_of(std::string_view name);

}  // namespace fiona::trust
