#pragma once

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "system_fixture.hpp"

namespace fiona::conformance {

/// A plugin of which another version can be built at any time.
class VersionedPlugin {
 public:
  VersionedPlugin() { build("version=1"); }

  const std::filesystem::path& directory() const { return built_.path; }
  std::filesystem::path library() const { return built_.path / "libversioned.so"; }
  /// A new build, as a linker leaves one: another file in the place of the old one.
  void build(const std::string& behaviour, const std::string& other_port = "", bool knows_paths = true) const {
    const std::filesystem::path from(VERSIONS_DIRECTORY);
    const auto next = built_.path / "next";
    std::filesystem::copy_file(from / "libversioned.so", next);
    std::filesystem::rename(next, library());
    std::stringstream interface;
    interface << std::ifstream(from / "versioned.interface.textproto").rdbuf();
    std::string text = interface.str();
    if (!other_port.empty()) text.replace(text.find("\"samples\""), 9, "\"" + other_port + "\"");
    const std::string is_path = "[fiona.host_path]: true";
    if (!knows_paths) text.erase(text.find(is_path, text.find("\"TickerParams\"")), is_path.size());
    std::ofstream(built_.path / "versioned.interface.textproto") << text;
    std::filesystem::create_directories(built_.path / "versioned.share");
    std::ofstream(built_.path / "versioned.share" / "behaviour") << behaviour;
  }
  /// As "x".
  control::Change load_in(const std::string& group) const {
    control::Change change;
    change.mutable_load()->set_plugin(library().string());
    change.mutable_load()->set_instance("x");
    change.mutable_load()->set_group(group);
    return change;
  }
  static control::Change upgrade_of(double watch_ms = 0) {
    control::Change change;
    change.mutable_upgrade()->set_instance("x");
    change.mutable_upgrade()->set_watch_ms(watch_ms);
    return change;
  }

 private:
  TemporaryDirectory built_;
};

}  // namespace fiona::conformance
