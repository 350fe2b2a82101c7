#pragma once

#include <optional>
#include <string_view>

namespace fiona {

/// What turns a number in unit `from` into one in unit `to`: `value * factor + offset`.
struct UnitConversion {
  double factor = 1;
  double offset = 0;
};

/// The conversion between two unit symbols of one dimension ("deg" to "rad", "200 ms" to "s"); none where the symbols
/// are unknown or measure different things. Equal symbols always convert.
std::optional<UnitConversion> convert_unit(std::string_view from, std::string_view to);

}  // namespace fiona
