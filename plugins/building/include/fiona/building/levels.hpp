#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::building {

/// Reads the value of an OSM `level` or `repeat_on` tag: "0", "-1", "0.5", "0;1", "1-3", "-2--1;4".
/// A range counts up in whole levels from its lower end and includes its upper end. Levels come in the order
/// of the text, each once. Nothing if the text is not such a list, or if it names more than 200 levels.
/// Source: OSM wiki, Key:level and Simple Indoor Tagging.
std::optional<std::vector<double>> parse_levels(std::string_view text);

/// Reads a plain number that ends where the text ends ("3.5", "-7"); units such as "3.5 m" are accepted for
/// metres.
std::optional<double> parse_metres(std::string_view text);

/// "0", "-1", "0.5": as OSM writes a level.
std::string level_text(double level);

/// Heights of the floors of a building above the floor of level 0. A storey is what lies between the floors
/// of two neighbouring whole levels; half levels (0.5) lie between them in proportion.
class Heights {
 public:
  /// The height of a storey that the file does not tell.
  static constexpr double kDefaultStorey_m = 3.0;

  explicit Heights(double default_storey_m = kDefaultStorey_m, std::map<int, double> storey_m = {});

  /// From the floor of `level` to the floor of `level + 1`.
  double storey_m(int level) const;
  double floor_m(double level) const;
  /// The other direction: the level, with its fraction, at this height.
  double level_at(double height_m) const;

 private:
  double default_storey_m_;
  std::map<int, double> storey_m_;
};

}  // namespace fiona::building
