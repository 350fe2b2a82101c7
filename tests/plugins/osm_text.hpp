#pragma once

#include <sstream>
#include <string>
#include <vector>

#include <fiona/building/building.hpp>

namespace fiona::building {

/// Builds OSM XML in metres around 48 N 10 E, where nodes are named by their ids.
class Osm {
 public:
  Osm& node(int id, double x_m, double y_m, const std::string& tags = "") {
    std::ostringstream line;
    line.precision(12);
    line << "<node id=\"" << id << "\" lat=\"" << 48.0 + y_m / 111194.87 << "\" lon=\"" << 10.0 + x_m / 74629.6 << "\">"
         << written(tags) << "</node>\n";
    nodes_ += line.str();
    return *this;
  }
  Osm& way(int id, const std::vector<int>& nodes, const std::string& tags) {
    ways_ += "<way id=\"" + std::to_string(id) + "\">";
    for (int node : nodes) ways_ += "<nd ref=\"" + std::to_string(node) + "\"/>";
    ways_ += written(tags) + "</way>\n";
    return *this;
  }
  /// A rectangle with nodes id .. id + 3 from its lower left corner; `on_south` are nodes on its south side.
  Osm& rectangle(int id, double x0, double y0, double x1, double y1, const std::string& tags,
                 const std::vector<int>& on_south = {}) {
    node(id, x0, y0).node(id + 1, x1, y0).node(id + 2, x1, y1).node(id + 3, x0, y1);
    std::vector<int> ring{id};
    ring.insert(ring.end(), on_south.begin(), on_south.end());
    for (int corner : {id + 1, id + 2, id + 3, id}) ring.push_back(corner);
    return way(id, ring, tags);
  }
  /// Each member is a way that is, or is a part of, a ring.
  Osm& multipolygon(int id, const std::vector<int>& outers, const std::vector<int>& inners, const std::string& tags) {
    relations_ += "<relation id=\"" + std::to_string(id) + "\">" + members(outers, "outer") + members(inners, "inner") +
                  written("type=multipolygon " + tags) + "</relation>\n";
    return *this;
  }
  std::string text() const {
    return "<?xml version='1.0'?><osm version='0.6'>\n<node id='1' lat='48.0' lon='10.0'>"
           "<tag k='fiona:reference' v='yes'/></node>\n" +
           nodes_ + ways_ + relations_ + "</osm>";
  }
  Building read() const { return Building::parse(text(), "house.osm"); }

 private:
  static std::string members(const std::vector<int>& ways, const std::string& role) {
    std::string xml;
    for (int way : ways) xml += "<member type=\"way\" ref=\"" + std::to_string(way) + "\" role=\"" + role + "\"/>";
    return xml;
  }
  /// "indoor=room level=0": no spaces within values.
  static std::string written(const std::string& tags) {
    std::string xml;
    std::istringstream words(tags);
    for (std::string word; words >> word;) {
      const std::size_t equals = word.find('=');
      xml += "<tag k=\"" + word.substr(0, equals) + "\" v=\"" + word.substr(equals + 1) + "\"/>";
    }
    return xml;
  }

  std::string nodes_{};
  std::string ways_{};
  std::string relations_{};
};

}  // namespace fiona::building
