#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "fiona/building/plan.hpp"

namespace fiona::building {

using Tags = std::map<std::string, std::string>;

struct OsmNode {
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  Tags tags{};
};

struct OsmWay {
  std::vector<std::int64_t> nodes{};
  Tags tags{};

  bool closed() const { return nodes.size() > 3 && nodes.front() == nodes.back(); }
};

struct OsmMember {
  ElementId id{};
  std::string role{};
};

struct OsmRelation {
  std::vector<OsmMember> members{};
  Tags tags{};
};

/// The elements of an OSM file, ordered by id: what is built from them does not depend on their order in the
/// file.
struct OsmFile {
  std::string name{};
  std::map<std::int64_t, OsmNode> nodes{};
  std::map<std::int64_t, OsmWay> ways{};
  std::map<std::int64_t, OsmRelation> relations{};
};

/// Throws fiona::Error that names the file, the cause and the next step.
OsmFile read_osm_file(const std::string& path);
OsmFile parse_osm(std::string_view bytes, const std::string& name);

/// The value of a tag, or "".
const std::string& tag(const Tags& tags, const std::string& key);

}  // namespace fiona::building
