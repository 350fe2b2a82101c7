#pragma once

#include <optional>
#include <string_view>

namespace fiona {

/// Standard gravity, 3rd CGPM 1901: how many m/s^2 one g is.
inline constexpr double kStandardGravity_mps2 = 9.80665;

/// What turns a number in unit `from` into one in unit `to`: `value * factor + offset`.
struct UnitConversion {
  double factor = 1;
  double offset = 0;
};

/// The conversion between two unit symbols of one dimension ("deg" to "rad", "200 ms" to "s"); none where the symbols
/// are unknown or measure different things. Equal symbols always convert.
std::optional<UnitConversion> convert_unit(std::string_view from, std::string_view to);

}  // namespace fiona
