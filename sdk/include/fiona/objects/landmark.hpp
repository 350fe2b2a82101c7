#pragma once

#include <charconv>
#include <cmath>
#include <optional>
#include <string>
#include <string_view>

#include "fiona/hmi.pb.h"

/// A point of attention as an entry of `landmark_list` (CommUserProfileReply in hmi.proto): "12.5,-3,1 lift B" is x, y
/// in metres, the level, and after one blank a name.
namespace fiona::hmi {

/// Nothing if it is not such a text, or has a number that is not finite. [any thread]
inline std::optional<PointOfAttention> parse_landmark(std::string_view text) {
  const auto number = [&text](char follower) -> std::optional<double> {
    double value = 0.0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || !std::isfinite(value)) return std::nullopt;
    text.remove_prefix(static_cast<std::size_t>(end - text.data()));
    if (text.empty()) return follower == ' ' ? std::optional(value) : std::nullopt;  // a name may be left out
    if (text.front() != follower) return std::nullopt;
    text.remove_prefix(1);
    return value;
  };
  const auto x = number(',');
  const auto y = x ? number(',') : std::nullopt;
  const auto level = y ? number(' ') : std::nullopt;
  if (!level) return std::nullopt;
  PointOfAttention point;
  point.set_x(*x);
  point.set_y(*y);
  point.set_level(*level);
  point.set_name(std::string(text));
  return point;
}

/// The text that is read as this point. [any thread]
inline std::string landmark_text(const PointOfAttention& point) {
  std::string made;
  for (const double value : {point.x(), point.y(), point.level()}) {
    char digits[32];
    made.append(made.empty() ? "" : ",").append(digits, std::to_chars(digits, digits + sizeof digits, value).ptr);
  }
  return point.name().empty() ? made : made + " " + point.name();
}

}  // namespace fiona::hmi
