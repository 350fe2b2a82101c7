#include "osm_file.hpp"

#include <filesystem>
#include <system_error>

#include <osmium/handler.hpp>
#include <osmium/io/reader.hpp>
#include <osmium/io/xml_input.hpp>
#include <osmium/thread/pool.hpp>
#include <osmium/visitor.hpp>

#include <fiona/error.hpp>

#include "fiona/building/building.hpp"

namespace fiona::building {
namespace {

Tags tags_of(const osmium::OSMObject& object) {
  Tags tags;
  for (const osmium::Tag& tag : object.tags()) tags.emplace(tag.key(), tag.value());
  return tags;
}

class Collector : public osmium::handler::Handler {
 public:
  explicit Collector(OsmFile& file) : file_(file) {}

  void node(const osmium::Node& node) {
    if (!node.visible() || !node.location().valid()) return;
    file_.nodes[node.id()] = {node.location().lat(), node.location().lon(), tags_of(node)};
  }

  void way(const osmium::Way& way) {
    if (!way.visible()) return;
    OsmWay& kept = file_.ways[way.id()];
    kept = {{}, tags_of(way)};
    for (const osmium::NodeRef& node : way.nodes()) kept.nodes.push_back(node.ref());
  }

  void relation(const osmium::Relation& relation) {
    if (!relation.visible()) return;
    OsmRelation& kept = file_.relations[relation.id()];
    kept = {{}, tags_of(relation)};
    for (const osmium::RelationMember& member : relation.members()) {
      kept.members.push_back({{osmium::item_type_to_char(member.type()), member.ref()}, member.role()});
    }
  }

 private:
  OsmFile& file_;
};

[[noreturn]] void refuse(const std::string& name, const std::string& cause, const std::string& next) {
  throw Error(ErrorCode::Failed, {.what = "cannot read the building file " + name + ": " + cause,
                                  .where = name,
                                  .expected = "OSM XML 0.6 with Simple Indoor Tagging",
                                  .next = next});
}

OsmFile collect(const osmium::io::File& source, const std::string& name) {
  OsmFile file;
  file.name = name;
  try {
    osmium::thread::Pool pool{1};  // the library's default pool would keep threads for the life of the process
    osmium::io::Reader reader{source, pool};
    Collector collector{file};
    osmium::apply(reader, collector);
    reader.close();
  } catch (const osmium::xml_error& error) {
    if (error.line == 0) refuse(name, error.what(), "open it in JOSM and save it again as .osm");
    refuse(
        name,
        "line " + std::to_string(error.line) + ", column " + std::to_string(error.column) + ": " + error.error_string,
        "open that line in an editor; a file that ends early was not fully copied: copy it again");
  } catch (const std::exception& error) {
    refuse(name, error.what(), "open it in JOSM and save it again as .osm");
  }
  return file;
}

}  // namespace

OsmFile read_osm_file(const std::string& path) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) {
    throw Error(ErrorCode::NotFound, {.what = "cannot read the building file " + path + ": there is no such file",
                                      .where = path,
                                      .next = "check the name and the directory"});
  }
  if (!std::filesystem::is_regular_file(status)) refuse(path, "it is not a file", "name a file that ends in .osm");
  const std::uintmax_t size = std::filesystem::file_size(path, error);
  if (error) refuse(path, error.message(), "check who may read it: ls -l " + path);
  if (size > Building::kMaxFileBytes) {
    refuse(path, "it has " + std::to_string(size >> 20) + " MiB and at most 256 MiB are read",
           "cut the building out: osmium extract -b WEST,SOUTH,EAST,NORTH " + path + " -o building.osm");
  }
  return collect(osmium::io::File{path, "osm"}, path);
}

OsmFile parse_osm(std::string_view xml, const std::string& name) {
  return collect(osmium::io::File{xml.data(), xml.size(), "osm"}, name);
}

const std::string& tag(const Tags& tags, const std::string& key) {
  static const std::string kNone;
  const auto found = tags.find(key);
  return found == tags.end() ? kNone : found->second;
}

}  // namespace fiona::building
