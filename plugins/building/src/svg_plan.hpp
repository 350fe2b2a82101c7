#pragma once

#include <string>

#include "fiona/building/svg.hpp"

namespace fiona::building {

/// The rectangle of the plan that a panel shows, and where it stands in the drawing.
struct View {
  Box box{};
  double scale = 1.0;  ///< px per m
  double left_px = 0.0;
  double top_px = 0.0;

  double x(double x_m) const { return left_px + (x_m - box.low.x_m) * scale; }
  double y(double y_m) const { return top_px + (box.high.y_m - y_m) * scale; }
  double width_px() const { return (box.high.x_m - box.low.x_m) * scale; }
  double height_px() const { return (box.high.y_m - box.low.y_m) * scale; }
  std::string at(Point p) const;  ///< "x,y"
};

/// Two decimals: a hundredth of a pixel.
std::string number(double value);
/// ` name="value"`
std::string attribute(const char* name, double value);
std::string draw_line(const View& view, const char* kind, const Segment& segment);

/// Rooms, stairs, walls and doors of a level, without names.
std::string draw_plan(const View& view, const Plan& plan, double level);
/// The names of the rooms of a level, where they fit.
std::string draw_names(const View& view, const Plan& plan, double level);

}  // namespace fiona::building
