#include "radio_localisation.hpp"

#include <google/protobuf/util/message_differencer.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>

#include "fiona/objects/step.hpp"
#include "radio_map_file.hpp"

namespace fiona::radio_localisation {
namespace {

/// What tells a beacon apart: its address, else what it advertises.
std::string beacon_id(const sensors::CommiBeacon& beacon) {
  if (!beacon.address().empty()) return beacon.address();
  return beacon.uuid() + "/" + std::to_string(beacon.major()) + "/" + std::to_string(beacon.minor());
}

std::string text_of(radio::Validity validity) {
  switch (validity) {
    case radio::Validity::Valid: return "valid";
    case radio::Validity::NoEvidence: return "nothing heard yet";
    case radio::Validity::ForeignBuilding: return "another building";
    case radio::Validity::Ambiguous: return "ambiguous";
  }
  return "unknown";
}

localisation::CommLocation location_of(const radio::Estimate& estimate, const radio::RadioMap& map) {
  localisation::CommLocation location;
  auto& position = *location.mutable_position();
  if (map.reference) {
    position.set_reference_lat(map.reference->latitude_deg);
    position.set_reference_long(map.reference->longitude_deg);
  }
  if (!estimate.is_valid()) return location;
  position.set_x(estimate.x_m);
  position.set_y(estimate.y_m);
  position.set_z(estimate.level);
  const auto& c = estimate.covariance;
  for (const double v : {c(0, 0), c(0, 1), 0.0, c(1, 0), c(1, 1), 0.0, 0.0, 0.0, estimate.level_variance}) {
    position.add_confidence(v);
  }
  position.set_is_valid(true);
  location.set_is_valid(true);
  return location;
}

/// The map that comes with the package, to try it: no map is a default, for each is of one building.
constexpr const char* kHouse = "house.radiomap";

}  // namespace

void RadioLocalisation::on_start() {
  if (params_->map().empty()) {
    throw Error(ErrorCode::Usage, {.what = "no radio map is named",
                                   .where = name(),
                                   .next = "fiona-radiomap learn FOLDER -o FILE, then load radio-localisation as " +
                                           name() + " map=FILE"});
  }
  std::error_code unknown;
  const bool is_packaged = params_->map() == kHouse && !std::filesystem::exists(kHouse, unknown);
  const std::filesystem::path file = is_packaged ? resource(kHouse) : std::filesystem::path(params_->map());
  map_ = std::make_shared<const radio::RadioMap>(radio::load(file));
  radio::FilterOptions options;
  options.particles = params_->particles();
  options.seed = params_->seed();
  filter_.emplace(map_, options);
}

void RadioLocalisation::check(const RadioLocalisationParams& draft) const {
  if (!filter_ || google::protobuf::util::MessageDifferencer::Equals(draft, *params_)) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the radio map, particles and seed are read when the instance starts",
                                      .where = name(),
                                      .next = "load another instance with map=" + draft.map() + ", and swap"});
}

void RadioLocalisation::on_wifi(const Received<sensors::RFSignalRSSI>& signal) {
  if (!signal->has_rss() || signal->rf_type() != "WiFi") return;
  use_row(signal->transmitter_id(), radio::Radio::WiFi, signal->rss(), signal.origin);
}

void RadioLocalisation::on_beacons(const Received<sensors::CommiBeaconList>& beacons) {
  std::int64_t newest_ms = std::numeric_limits<std::int64_t>::min();
  for (const auto& beacon : beacons->beacon_list()) {
    if (beacon.has_t()) newest_ms = std::max(newest_ms, std::int64_t{beacon.t()});
  }
  std::map<std::string, std::int64_t> told;
  for (const auto& beacon : beacons->beacon_list()) {
    if (!beacon.has_rssi()) continue;
    const std::string id = beacon_id(beacon);
    if (beacon.has_t()) {
      told.emplace(id, beacon.t());
      const auto before = told_.find(id);
      if (before != told_.end() && before->second == beacon.t()) continue;
    }
    const radio::Time before_newest(beacon.has_t() ? newest_ms - beacon.t() : 0);
    use_row(id, radio::Radio::Bluetooth, beacon.rssi(), beacons.origin - before_newest);
  }
  told_ = std::move(told);
}

/// When it was heard is told by a message's origin, which is of this instance's clock wherever it comes from; times in
/// messages are of their sender's, and tell nothing but how far apart they are.
void RadioLocalisation::use_row(const std::string& id, radio::Radio radio, double rssi_dbm, TimePoint heard) {
  const radio::Time heard_ms(to_milliseconds(heard));
  if (clock_ms() - heard_ms > radio::RadioFilter::kOldestRow) return old_.set(++old_rows_);
  filter_->signal(clock_ms(), {id, radio, rssi_dbm, heard_ms});
}

void RadioLocalisation::on_step(const Received<localisation::CommStep>& step) {
  if (!step->is_valid()) return;
  const radio::Time ended = std::min(clock_ms(), radio::Time(to_milliseconds(step.origin)));
  filter_->step(
      {ended, step->length(), localisation::length_sd_m(*step), step->heading(), localisation::heading_sd_rad(*step)});
}

void RadioLocalisation::produce() {
  const TimePoint heard_until = now();
  filter_->expect_steps(steps_.connection() == Connection::Connected);
  filter_->advance(clock_ms());
  const radio::Estimate estimate = filter_->estimate();
  note_validity(estimate.validity);
  show(estimate);
  location_.put(location_of(estimate, *map_), heard_until);
}

void RadioLocalisation::show(const radio::Estimate& estimate) {
  spread_.set(estimate.is_valid() ? std::sqrt(estimate.covariance.trace()) : std::numeric_limits<double>::infinity());
  known_share_.set(estimate.known_share);
  validity_probe_.set(text_of(estimate.validity));
}

/// Says once, each time that it changes, why there is no position.
void RadioLocalisation::note_validity(radio::Validity validity) {
  if (validity == validity_) return;
  validity_ = validity;
  if (validity == radio::Validity::ForeignBuilding) {
    log(LogLevel::Warning, "hardly any transmitter that is heard is in radio map '" + map_->name +
                               "': this is another building, or the survey is out of date");
  }
  if (validity == radio::Validity::Ambiguous) log(LogLevel::Info, "what is heard fits too many places");
}

}  // namespace fiona::radio_localisation
