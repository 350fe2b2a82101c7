#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace fiona::map_server {

/// NAME@LEVEL, taken apart.
struct MapName {
  std::string name{};
  double level = 0.0;

  /// Nothing where there is no '@', or no single level behind the last one.
  static std::optional<MapName> parse(std::string_view text);
  std::string text() const;
};

/// Whether it can be a NAME: some text without '@', '/', ".." and control characters. It is a key, never a path.
bool is_map_name(std::string_view name);

}  // namespace fiona::map_server
