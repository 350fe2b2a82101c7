#include "fiona/units.hpp"

#include <algorithm>
#include <array>
#include <numbers>

namespace fiona {
namespace {

enum class Dimension {
  Time,
  Length,
  Angle,
  AngularRate,
  Speed,
  Acceleration,
  MagneticField,
  Frequency,
  Temperature,
  Pressure,
  Fraction,
  Information
};

struct Unit {
  std::string_view symbol;
  Dimension dimension;
  double factor;      ///< to the dimension's SI unit
  double offset = 0;  ///< added after the factor
};

constexpr double kDegree = std::numbers::pi / 180;

constexpr std::array kUnits = {
    Unit{"ns", Dimension::Time, 1e-9},
    Unit{"us", Dimension::Time, 1e-6},
    Unit{"ms", Dimension::Time, 1e-3},
    Unit{"s", Dimension::Time, 1},
    Unit{"min", Dimension::Time, 60},
    Unit{"h", Dimension::Time, 3600},
    Unit{"mm", Dimension::Length, 1e-3},
    Unit{"cm", Dimension::Length, 1e-2},
    Unit{"m", Dimension::Length, 1},
    Unit{"km", Dimension::Length, 1e3},
    Unit{"rad", Dimension::Angle, 1},
    Unit{"deg", Dimension::Angle, kDegree},
    Unit{"rad/s", Dimension::AngularRate, 1},
    Unit{"deg/s", Dimension::AngularRate, kDegree},
    Unit{"m/s", Dimension::Speed, 1},
    Unit{"km/h", Dimension::Speed, 1 / 3.6},
    Unit{"m/s^2", Dimension::Acceleration, 1},
    Unit{"g", Dimension::Acceleration, kStandardGravity_mps2},
    Unit{"T", Dimension::MagneticField, 1},
    Unit{"uT", Dimension::MagneticField, 1e-6},
    Unit{"gauss", Dimension::MagneticField, 1e-4},
    Unit{"Hz", Dimension::Frequency, 1},
    Unit{"kHz", Dimension::Frequency, 1e3},
    Unit{"MHz", Dimension::Frequency, 1e6},
    Unit{"K", Dimension::Temperature, 1},
    Unit{"degC", Dimension::Temperature, 1, 273.15},
    Unit{"Pa", Dimension::Pressure, 1},
    Unit{"hPa", Dimension::Pressure, 100},
    Unit{"%", Dimension::Fraction, 0.01},
    Unit{"B", Dimension::Information, 1},
    Unit{"KiB", Dimension::Information, 1024},
    Unit{"MiB", Dimension::Information, 1024 * 1024},
};

const Unit* find_unit(std::string_view symbol) {
  const auto* found =
      std::find_if(kUnits.begin(), kUnits.end(), [symbol](const Unit& u) { return u.symbol == symbol; });
  return found == kUnits.end() ? nullptr : found;
}

}  // namespace

std::optional<UnitConversion> convert_unit(std::string_view from, std::string_view to) {
  if (from == to) return UnitConversion{};
  const Unit* source = find_unit(from);
  const Unit* target = find_unit(to);
  if (!source || !target || source->dimension != target->dimension) return std::nullopt;
  return UnitConversion{source->factor / target->factor, (source->offset - target->offset) / target->factor};
}

}  // namespace fiona
