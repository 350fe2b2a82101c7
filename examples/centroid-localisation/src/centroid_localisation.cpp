#include "centroid_localisation.hpp"

#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <fstream>
#include <sstream>

#include <fiona/error.hpp>

#include "acme/centroid_localisation/beacons.pb.h"

namespace acme::centroid_localisation {
namespace {

using fiona::Error;
using fiona::ErrorCode;

constexpr double kExponent = 2.0;  ///< of the path loss, in the open
/// No better than this, however the beacons lie: half of the usual distance between them.
constexpr double kFloor_m = 3.0;
constexpr std::chrono::seconds kOldestOrientation{1};

/// Keeps the first error, with its place.
struct FirstError final : google::protobuf::io::ErrorCollector {
  std::string text;
  void AddError(int line, google::protobuf::io::ColumnNumber column, const std::string& message) override {
    if (text.empty()) text = std::to_string(line + 1) + ":" + std::to_string(column + 1) + ": " + message;
  }
};

/// Lower-case, an address without its colons: files write ids in several ways.
std::string plain(std::string id) {
  if (id.find('/') == std::string::npos) std::erase_if(id, [](char c) { return c == ':' || c == '-'; });
  std::transform(id.begin(), id.end(), id.begin(), [](unsigned char c) { return std::tolower(c); });
  return id;
}

Beacons read(const std::string& file) {
  std::ifstream in(file);
  std::stringstream content;
  content << in.rdbuf();
  FirstError error;
  google::protobuf::TextFormat::Parser parser;
  parser.AllowUnknownField(true);
  parser.RecordErrorsTo(&error);
  Beacons beacons;
  if (!in) error.text = "it cannot be read";
  if (error.text.empty() && parser.ParseFromString(content.str(), &beacons) && beacons.beacons_size() > 0)
    return beacons;
  throw Error(ErrorCode::Usage,
              {.what = "there are no beacons' places",
               .where = file.empty() ? "beacons" : file,
               .expected = "beacons { id: 'UUID/MAJOR/MINOR' x: 0 y: 0 heard { level: 0 power: -59 } }",
               .found = file.empty() ? "no file" : error.text,
               .next = "fiona-beaconmap drawn BUILDING.osm -o FILE; then beacons=FILE"});
}

}  // namespace

void CentroidLocalisation::on_start() {
  if (params_->beacons().empty()) {
    log(fiona::LogLevel::Warning,
        "no beacons' places are named: every location will be not valid; load it with beacons=FILE");
    return;
  }
  const Beacons file = read(params_->beacons());
  for (const Beacon& beacon : file.beacons()) {
    const auto strongest = std::max_element(beacon.heard().begin(), beacon.heard().end(),
                                            [](const Heard& a, const Heard& b) { return a.power() < b.power(); });
    if (strongest == beacon.heard().end()) continue;
    places_[plain(beacon.id())] = {beacon.x(), beacon.y(), strongest->level(), strongest->power()};
  }
}

void CentroidLocalisation::on_beacons(const fiona::sensors::CommiBeaconList& list) {
  for (const auto& beacon : list.beacon_list()) {
    if (!beacon.has_rssi()) continue;
    std::string id = plain(beacon.address());
    if (!places_.contains(id))
      id = plain(beacon.uuid() + "/" + std::to_string(beacon.major()) + "/" + std::to_string(beacon.minor()));
    if (places_.contains(id)) readings_[id] = {static_cast<double>(beacon.rssi()), now()};
  }
}

void CentroidLocalisation::on_orientation(const fiona::Received<fiona::localisation::CommOrientation>& orientation) {
  orientation_ = orientation;
}

std::map<int, CentroidLocalisation::Sums> CentroidLocalisation::sums() const {
  std::map<int, Sums> levels;
  for (const auto& [id, reading] : readings_) {
    const Place& place = places_.at(id);
    const double distance_m = std::pow(10.0, (place.power_dbm - reading.rssi_dbm) / (10.0 * kExponent));
    const double weight = std::pow(std::max(1.0, distance_m), -params_->degree());
    Sums& sums = levels[place.level];
    sums.weight += weight;
    sums.squares += weight * weight;
    sums.x += weight * place.x_m;
    sums.y += weight * place.y_m;
    sums.xx += weight * place.x_m * place.x_m;
    sums.xy += weight * place.x_m * place.y_m;
    sums.yy += weight * place.y_m * place.y_m;
  }
  return levels;
}

void CentroidLocalisation::produce_location() {
  const auto oldest =
      now() - std::chrono::duration_cast<fiona::Duration>(std::chrono::duration<double>(params_->window()));
  std::erase_if(readings_, [&](const auto& entry) { return entry.second.heard < oldest; });
  heard_.set(readings_.size());
  fiona::localisation::CommLocation location;
  if (orientation_ && (*orientation_)->is_valid() && now() - orientation_->origin <= kOldestOrientation) {
    *location.mutable_orientation() = **orientation_;
  }
  const auto levels = sums();
  const auto best = std::max_element(levels.begin(), levels.end(),
                                     [](const auto& a, const auto& b) { return a.second.weight < b.second.weight; });
  if (best != levels.end()) {
    const Sums& s = best->second;
    auto& position = *location.mutable_position();
    const double x = s.x / s.weight, y = s.y / s.weight;
    position.set_x(x);
    position.set_y(y);
    position.set_z(best->first);
    // The covariance of a weighted mean of beacons' places, each of which errs as they are spread.
    const double share = s.squares / (s.weight * s.weight);
    const double floor = kFloor_m * kFloor_m;
    const double xy = share * (s.xy / s.weight - x * y);
    const double xx = floor + share * std::max(0.0, s.xx / s.weight - x * x);
    const double yy = floor + share * std::max(0.0, s.yy / s.weight - y * y);
    for (const double v : {xx, xy, 0.0, xy, yy, 0.0, 0.0, 0.0, 0.25}) position.add_confidence(v);
    position.set_is_valid(true);
    location.set_is_valid(true);
  }
  location_.put(std::move(location));
}

}  // namespace acme::centroid_localisation
