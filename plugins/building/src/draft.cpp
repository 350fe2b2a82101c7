#include "draft.hpp"

#include <algorithm>
#include <cmath>

namespace fiona::building {
namespace {

using NodeRing = std::vector<std::int64_t>;

/// Joins open ways end to end into rings; what stays open is dropped, and noted.
std::vector<NodeRing> join(std::vector<NodeRing> pieces, bool& is_whole) {
  std::multimap<std::int64_t, std::size_t> at_end;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    at_end.emplace(pieces[i].front(), i);
    at_end.emplace(pieces[i].back(), i);
  }
  std::vector<bool> used(pieces.size(), false);
  const auto next_at = [&](std::int64_t node) -> std::optional<std::size_t> {
    for (auto [at, last] = at_end.equal_range(node); at != last; at = at_end.erase(at)) {
      if (!used[at->second]) return at->second;
    }
    return std::nullopt;
  };
  std::vector<NodeRing> rings;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    if (used[i]) continue;
    used[i] = true;
    NodeRing ring = std::move(pieces[i]);
    while (ring.front() != ring.back()) {
      const auto next = next_at(ring.back());
      if (!next) break;
      used[*next] = true;
      NodeRing& piece = pieces[*next];
      if (piece.front() != ring.back()) std::reverse(piece.begin(), piece.end());
      ring.insert(ring.end(), piece.begin() + 1, piece.end());
    }
    if (ring.size() < 4 || ring.front() != ring.back()) {
      is_whole = false;
      continue;
    }
    ring.pop_back();
    rings.push_back(std::move(ring));
  }
  return rings;
}

Area area_of(const OsmFile& file, std::int64_t id, const OsmRelation& relation) {
  Area area{{'r', id}, &relation.tags, {}, {}, {}};
  std::vector<NodeRing> outer_pieces, inner_pieces;
  for (const OsmMember& member : relation.members) {
    if (member.id.kind != 'w') continue;
    const auto way = file.ways.find(member.id.number);
    if (way == file.ways.end() || way->second.nodes.size() < 2) {
      area.is_whole = false;
      continue;
    }
    (member.role == "inner" ? inner_pieces : outer_pieces).push_back(way->second.nodes);
    area.ways.push_back(way->first);
  }
  area.outers = join(std::move(outer_pieces), area.is_whole);
  area.inners = join(std::move(inner_pieces), area.is_whole);
  return area;
}

}  // namespace

std::string text(ElementId id) {
  const char* kind = id.kind == 'n' ? "node " : id.kind == 'w' ? "way " : "relation ";
  return kind + std::to_string(id.number);
}

void Draft::warn(ElementId id, const std::string& sentence) {
  constexpr std::size_t kMostWarnings = 1000;
  if (plan.warnings.size() < kMostWarnings) {
    plan.warnings.push_back(text(id) + ": " + sentence);
  } else {
    ++untold;
  }
}

std::vector<double> Draft::levels_of(ElementId id, const Tags& tags) {
  std::vector<double> levels;
  for (const char* key : {"level", "repeat_on"}) {
    const std::string& value = tag(tags, key);
    if (value.empty()) continue;
    const auto parsed = parse_levels(value);
    if (!parsed) {
      warn(id, std::string(key) + "=" + value + " is not a list of levels such as 0, -1;0 or 1-3; left out");
      continue;
    }
    for (double level : *parsed) {
      const bool known = std::find(levels.begin(), levels.end(), level) != levels.end();
      if (!known && !absent_levels.contains(level)) levels.push_back(level);
    }
  }
  return levels;
}

std::optional<Point> Draft::place_of(ElementId user, std::int64_t number) {
  const auto node = file.nodes.find(number);
  if (node == file.nodes.end()) {
    warn(user, "node " + std::to_string(number) + " is not in the file; left out");
    return std::nullopt;
  }
  const Point point = at(node->second);
  if (std::abs(point.x_m) <= kFarthest_m && std::abs(point.y_m) <= kFarthest_m) return point;
  warn(user, "node " + std::to_string(number) + " is more than " + std::to_string(std::lround(kFarthest_m / 1000)) +
                 " km away from the building; left out");
  return std::nullopt;
}

std::optional<std::vector<Point>> Draft::points_of(std::int64_t way) {
  std::vector<Point> points;
  for (std::int64_t id : file.ways.at(way).nodes) {
    const std::optional<Point> point = place_of({'w', way}, id);
    if (!point) return std::nullopt;
    points.push_back(*point);
  }
  return points;
}

std::optional<double> Draft::attenuation_db(ElementId id, const Tags& tags) {
  if (const std::string& value = tag(tags, "fiona:attenuation"); !value.empty()) {
    const auto number = parse_metres(value);
    if (number && *number >= 0.0 && *number <= 200.0) return number;
    warn(id, "fiona:attenuation=" + value + " is not a number of dB between 0 and 200; not used");
  }
  for (const char* key : {"wall:material", "material"}) {
    if (const auto known = material_attenuation_db(tag(tags, key))) return known;
  }
  return std::nullopt;
}

int access_level(Draft& draft, ElementId id, const Tags& tags) {
  static const std::set<std::string> kRights = {"private", "staff", "employees", "permit", "delivery", "emergency"};
  if (const std::string& value = tag(tags, "fiona:access"); !value.empty()) {
    const auto level = parse_metres(value);
    if (level && *level >= kOpen && *level <= kClosed && *level == std::floor(*level)) return static_cast<int>(*level);
    draft.warn(id, "fiona:access=" + value + " is not a whole number from 0 to 10; closed");
    return kClosed;
  }
  const std::string& access = tags.contains("foot") ? tag(tags, "foot") : tag(tags, "access");
  return access == "no" ? kClosed : kRights.contains(access) ? kByRight : kOpen;
}

std::vector<Area> areas_of(const OsmFile& file) {
  std::vector<Area> areas;
  for (const auto& [id, way] : file.ways) {
    if (!way.closed() || way.tags.empty()) continue;
    areas.push_back({{'w', id}, &way.tags, {{way.nodes.begin(), way.nodes.end() - 1}}, {}, {id}});
  }
  for (const auto& [id, relation] : file.relations) {
    if (tag(relation.tags, "type") == "multipolygon") areas.push_back(area_of(file, id, relation));
  }
  return areas;
}

bool is_indoor_area(const Tags& tags) {
  const std::string& indoor = tag(tags, "indoor");
  if (indoor == "room" || indoor == "corridor" || indoor == "area") return true;
  if (tags.contains("room") || tag(tags, "highway") == "elevator") return true;
  return tag(tags, "area") == "yes" && tags.contains("highway") && tags.contains("level");
}

}  // namespace fiona::building
