#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include "hang_watch.hpp"
#include "plugin_library.hpp"

namespace fiona::host {

/// Opens each library in a process that is thrown away, before the host opens it in its own: what a static constructor
/// does, a trap, an exit or an endless loop, happens there. The verdict holds for the files as they are, those of the
/// message packages among them, and for this host: the next one asks again.
class Trials {
 public:
  /// How long opening may take: as long as in a group, beside what it waits for a processor.
  static constexpr std::chrono::milliseconds kWithin = HangWatch::kOpening;

  /// Throws Error Failed, if opening the libraries of this plugin ends a process or does not end. What the loader
  /// refuses passes: it says why to whoever opens it.
  void require(const std::string& plugin, const PluginLibraries::Files& files);

 private:
  using File =
      std::tuple<std::string, std::uint64_t, std::uint64_t, std::int64_t>;  ///< path, device, inode, time of writing
  struct Verdict {
    std::vector<File> files;
    std::string fault;  ///< empty: none
  };
  static std::vector<File> identities_of(const PluginLibraries::Files& files);

  std::map<std::filesystem::path, Verdict> verdicts_;  ///< as many as there are libraries
};

}  // namespace fiona::host
