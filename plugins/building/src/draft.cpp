#include "draft.hpp"

#include <algorithm>

namespace fiona::building {
namespace {

using NodeRing = std::vector<std::int64_t>;

/// Joins open ways end to end into rings; what stays open is dropped.
std::vector<NodeRing> join(std::vector<NodeRing> pieces) {
  std::vector<NodeRing> rings;
  while (!pieces.empty()) {
    NodeRing ring = std::move(pieces.back());
    pieces.pop_back();
    bool grown = true;
    while (grown && ring.front() != ring.back()) {
      grown = false;
      for (auto piece = pieces.begin(); piece != pieces.end(); ++piece) {
        if (piece->back() == ring.back()) std::reverse(piece->begin(), piece->end());
        if (piece->front() != ring.back()) continue;
        ring.insert(ring.end(), piece->begin() + 1, piece->end());
        pieces.erase(piece);
        grown = true;
        break;
      }
    }
    if (ring.size() < 4 || ring.front() != ring.back()) continue;
    ring.pop_back();
    rings.push_back(std::move(ring));
  }
  return rings;
}

Area area_of(const OsmFile& file, std::int64_t id, const OsmRelation& relation) {
  Area area{{'r', id}, &relation.tags, {}, {}, {}};
  std::vector<NodeRing> outer_pieces, inner_pieces;
  for (const OsmMember& member : relation.members) {
    const auto way = member.id.kind == 'w' ? file.ways.find(member.id.number) : file.ways.end();
    if (way == file.ways.end() || way->second.nodes.size() < 2) continue;
    (member.role == "inner" ? inner_pieces : outer_pieces).push_back(way->second.nodes);
    area.ways.push_back(way->first);
  }
  area.outers = join(std::move(outer_pieces));
  area.inners = join(std::move(inner_pieces));
  return area;
}

}  // namespace

std::string text(ElementId id) {
  const char* kind = id.kind == 'n' ? "node " : id.kind == 'w' ? "way " : "relation ";
  return kind + std::to_string(id.number);
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

std::optional<std::vector<Point>> Draft::points_of(std::int64_t way) {
  std::vector<Point> points;
  for (std::int64_t id : file.ways.at(way).nodes) {
    const auto node = file.nodes.find(id);
    if (node == file.nodes.end()) {
      warn({'w', way}, "node " + std::to_string(id) + " is not in the file; left out");
      return std::nullopt;
    }
    points.push_back(at(node->second));
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
