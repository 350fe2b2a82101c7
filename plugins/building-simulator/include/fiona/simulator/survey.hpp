#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <fiona/building/building.hpp>

#include "fiona/simulator/imu_model.hpp"
#include "fiona/simulator/radio_model.hpp"
#include "fiona/simulator/walker.hpp"

namespace fiona::simulator {

/// One recorded walk on one level; times since its start.
struct Trace {
  std::string id{};  ///< 24 hexadecimal digits
  double level = 0.0;
  std::vector<ImuSample> imu{};  ///< empty for walks that record radio only
  std::vector<WifiScan> scans{};
  std::vector<BeaconReading> beacons{};
  std::vector<Truth> waypoints{};  ///< corners of the way, ascending in time; close to straight in between
  milliseconds duration{0};
};

struct SurveyOptions {
  double spacing_m = 2.5;             ///< between the points that are visited
  milliseconds longest_walk{60'000};  ///< at full pace; turns make it a little longer
  std::size_t inertial_walks = 10;    ///< on each level, the first so many record the IMU too
  std::size_t test_walks = 14;        ///< on each level: between rooms at random, with all sensors
  milliseconds test_duration{45'000};
  Gait gait{};
  ImuOptions imu{};
  RadioOptions radio{};
};

/// A systematic walk over all rooms and corridors of a level: every point of a grid that can be reached, cut
/// into walks. Throws fiona::Error (NotFound) if the level has no room.
std::vector<Trace> survey_walk(const building::Building& building, double level, std::uint64_t seed,
                               const SurveyOptions& options = {});

/// Walks between rooms of a level chosen at random, other than those of the survey, in the same radio world.
std::vector<Trace> test_walks(const building::Building& building, double level, std::uint64_t seed,
                              const SurveyOptions& options = {});

/// What `write_survey` has made.
struct SurveyReport {
  std::size_t levels = 0;
  std::size_t survey_walks = 0;
  std::size_t test_walks = 0;
  std::vector<std::string> notes{};  ///< levels that were left out, and why
};

/// Surveys all whole levels of the building that have rooms, and writes a directory in the layout of the
/// indoor20_site1 data set: FLOOR/train.tar.xz and FLOOR/floor_info.json (FLOOR is B1 for level -1, F1 for
/// level 0), test.tar.xz, test_truth.csv, traces.csv. Places are in the local frame of the building. The
/// directory must not exist or be empty. The same seed gives the same bytes.
SurveyReport write_survey(const building::Building& building, std::uint64_t seed,
                          const std::filesystem::path& directory, const SurveyOptions& options = {});

}  // namespace fiona::simulator
