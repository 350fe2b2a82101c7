#pragma once

#include <filesystem>
#include <istream>
#include <string>
#include <vector>

#include "survey_learner.hpp"

namespace fiona::beacons {

/// A survey by any means, rows of `walk,second,x,y,level,beacon,rssi_dbm` below a line that names them so: one row for
/// each beacon that a second heard, or one with an empty beacon. Throws fiona::Error that names the line.
std::vector<SurveySecond> read_survey(const std::filesystem::path& file);
/// The same from a stream, `name` standing for the file in errors.
std::vector<SurveySecond> read_survey(std::istream& stream, const std::string& name);

/// What one receiver heard without saying where: rows of `track,t_ms,beacon,rssi_dbm`, ascending by time.
struct TrackRow {
  std::string track;
  std::int64_t t_ms;
  std::string beacon;
  double rssi_dbm;
};
std::vector<TrackRow> read_tracks(const std::filesystem::path& file);
std::vector<TrackRow> read_tracks(std::istream& stream, const std::string& name);

}  // namespace fiona::beacons
