#include "osm_file.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <system_error>

#include <osmium/handler.hpp>
#include <osmium/io/pbf_input.hpp>
#include <osmium/io/reader.hpp>
#include <osmium/io/xml_input.hpp>
#include <osmium/thread/pool.hpp>
#include <osmium/visitor.hpp>

#include <utf8proc.h>
#include <fiona/error.hpp>

#include "fiona/building/building.hpp"

namespace fiona::building {
namespace {

/// Expat has seen to it for XML; PBF may hold anything, and a protobuf string may not.
bool is_utf8(std::string_view text) {
  const auto* at = reinterpret_cast<const utf8proc_uint8_t*>(text.data());
  for (auto left = static_cast<utf8proc_ssize_t>(text.size()); left > 0;) {
    utf8proc_int32_t character = 0;
    const utf8proc_ssize_t taken = utf8proc_iterate(at, left, &character);
    if (taken <= 0) return false;
    at += taken;
    left -= taken;
  }
  return true;
}

Tags tags_of(const osmium::OSMObject& object) {
  Tags tags;
  for (const osmium::Tag& tag : object.tags()) {
    if (is_utf8(tag.key()) && is_utf8(tag.value())) tags.emplace(tag.key(), tag.value());
  }
  return tags;
}

[[noreturn]] void refuse(const std::string& name, const std::string& cause, const std::string& next) {
  throw Error(ErrorCode::Failed, {.what = "cannot read the building file " + name + ": " + cause,
                                  .where = name,
                                  .expected = "OSM XML 0.6 or PBF with Simple Indoor Tagging",
                                  .next = next});
}

/// More than any building has, and what a packed file can swell to is bounded by it: PBF unpacks to a thousand times
/// its size.
constexpr std::size_t kMostParts = 3'000'000;
constexpr std::size_t kMostTagBytes = 64u << 20;

class Collector : public osmium::handler::Handler {
 public:
  explicit Collector(OsmFile& file) : file_(file) {}

  void node(const osmium::Node& node) {
    if (!node.visible() || !node.location().valid()) return;
    count(1, node.tags());
    file_.nodes[node.id()] = {node.location().lat(), node.location().lon(), tags_of(node)};
  }

  void way(const osmium::Way& way) {
    if (!way.visible()) return;
    count(1 + way.nodes().size(), way.tags());
    OsmWay& kept = file_.ways[way.id()];
    kept = {{}, tags_of(way)};
    for (const osmium::NodeRef& node : way.nodes()) kept.nodes.push_back(node.ref());
  }

  void relation(const osmium::Relation& relation) {
    if (!relation.visible()) return;
    count(1 + relation.members().size(), relation.tags());
    OsmRelation& kept = file_.relations[relation.id()];
    kept = {{}, tags_of(relation)};
    for (const osmium::RelationMember& member : relation.members()) {
      kept.members.push_back({{osmium::item_type_to_char(member.type()), member.ref()}, member.role()});
    }
  }

 private:
  void count(std::size_t parts, const osmium::TagList& tags) {
    parts_ += parts + tags.size();
    tag_bytes_ += tags.byte_size();
    if (parts_ <= kMostParts && tag_bytes_ <= kMostTagBytes) return;
    refuse(file_.name,
           parts_ > kMostParts ? "it has more than 3000000 nodes, tags and members" : "its tags have more than 64 MiB",
           "cut the building out: osmium extract -b WEST,SOUTH,EAST,NORTH " + file_.name + " -o building.osm");
  }

  OsmFile& file_;
  std::size_t parts_ = 0;
  std::size_t tag_bytes_ = 0;
};

/// By content: a file that was named wrongly is read all the same. A PBF file begins with the length of a BlobHeader,
/// and in it, as field 1, the type of the first blob. Source: OSM wiki, PBF Format.
const char* format_of(std::string_view begin) {
  constexpr std::string_view kFirstBlob = "\x0a\x09OSMHeader";
  return begin.size() > 4 && begin.substr(4).starts_with(kFirstBlob) ? "pbf" : "osm";
}

/// What unpacks it, where it is compressed as a whole.
const char* packer_of(std::string_view begin) {
  if (begin.starts_with("\x1f\x8b")) return "gzip";
  if (begin.starts_with("\xfd\x37zXZ")) return "xz";
  return begin.starts_with("BZh") ? "bzip2" : nullptr;
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
  } catch (const Error&) {
    throw;
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
  char begin[16] = {};
  std::ifstream(path, std::ios::binary).read(begin, sizeof(begin));
  if (const char* const packer = packer_of({begin, sizeof(begin)})) {
    refuse(path, std::string("it is compressed with ") + packer,
           std::string("unpack it first: ") + packer + " -dc < " + path + " > unpacked.osm");
  }
  return collect(osmium::io::File{path, format_of({begin, sizeof(begin)})}, path);
}

OsmFile parse_osm(std::string_view bytes, const std::string& name) {
  return collect(osmium::io::File{bytes.data(), bytes.size(), format_of(bytes)}, name);
}

const std::string& tag(const Tags& tags, const std::string& key) {
  static const std::string kNone;
  const auto found = tags.find(key);
  return found == tags.end() ? kNone : found->second;
}

}  // namespace fiona::building
