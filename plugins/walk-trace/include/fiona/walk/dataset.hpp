#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <fiona/walk/walk.hpp>

namespace fiona::walk {

/// What a recording may cost at most. A file beyond a limit is refused with an error, never half read.
struct Limits {
  std::uint64_t archive_bytes = 1ull << 30;  ///< size of one .tar.xz
  std::uint64_t walk_bytes = 256ull << 20;   ///< text of one walk, unpacked
  std::size_t line_bytes = 1024;
  std::size_t walk_events = 4'000'000;
  std::size_t walks = 100'000;  ///< in one archive
};

/// Called once per walk, in the order of the archive. Return false to stop.
using WalkVisitor = std::function<bool(const Walk&)>;

/// A folder of recorded walks, read straight from its .tar.xz archives, one walk in memory at a time.
///
/// Two layouts are recognised: one folder per floor (`B1/train.tar.xz`, `F1/train.tar.xz`, …; B1 is level -1, F1 level 0,
/// F2 level 1) and one `train.tar.xz` at the top, whose way-points carry their level. `test.tar.xz` at the top holds the
/// test walks. The README has the rows.
///
/// Every function throws fiona::Error naming the archive, the walk and the line when something is missing,
/// truncated or garbled.
class Dataset {
 public:
  /// Looks at file names only. Throws NotFound when `folder` is none of the layouts.
  static Dataset open(const std::filesystem::path& folder, const Limits& limits = {});

  /// Walks with way-points, floor by floor. Cost: one pass over the survey archives.
  void for_each_survey_walk(const WalkVisitor& visit) const;

  /// Walks without way-points. Cost: one pass over the test archive.
  void for_each_test_walk(const WalkVisitor& visit) const;

  /// Names of the test walks, in the order of the archive.
  std::vector<std::string> walk_names() const;

  /// The test or survey walk of that name. Throws NotFound, with the nearest names, when there is none.
  Walk walk(const std::string& name) const;

  /// Name of the folder: what a map learnt from it is called.
  std::string name() const;

 private:
  struct Archive {
    std::filesystem::path file;
    std::optional<int> level;
  };
  Dataset(std::filesystem::path folder, Limits limits) : folder_(std::move(folder)), limits_(limits) {}

  std::filesystem::path folder_;
  Limits limits_;
  std::vector<Archive> survey_;
  std::optional<Archive> test_;
};

/// Level of a floor's name: B2 -> -2, F1 or 1F -> 0, F7 -> 6. Empty for any other name.
std::optional<int> level_of_floor_name(const std::string& name);

}  // namespace fiona::walk
