#pragma once

#include <string>
#include <vector>

namespace fiona::marketplace::testing {

/// An archive that no honest tool makes.
struct HostileArchiveKind {
  std::string name;   ///< what is wrong with it
  std::string bytes;  ///< of the .fpk
};

/// Made of an honest package with the files interface.textproto, README.md, lib/libsteps.so, share/data/map.osm and
/// share/help.txt: each kind changes one thing.
std::vector<HostileArchiveKind> hostile_corpus(const std::string& honest);

}  // namespace fiona::marketplace::testing
