#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <tuple>

#include "plugin_library.hpp"

namespace fiona::host {

/// Opens each library in a process that is thrown away, before the host opens it in its own: what a static constructor
/// does, a trap, an exit or an endless loop, happens there. The verdict holds for the file as it is.
class Trials {
 public:
  /// How long opening may take.
  static constexpr std::chrono::milliseconds kWithin{3000};

  /// Throws Error Failed, if opening the libraries of this plugin ends a process or does not end. What the loader
  /// refuses passes: it says why to whoever opens it.
  void require(const std::string& plugin, const PluginLibraries::Files& files);

 private:
  struct Verdict {
    std::tuple<std::uint64_t, std::uint64_t, std::int64_t> file;  ///< its device, inode and time of writing
    std::string fault;                                            ///< empty: none
  };
  std::map<std::filesystem::path, Verdict> verdicts_;  ///< as many as there are libraries
};

}  // namespace fiona::host
