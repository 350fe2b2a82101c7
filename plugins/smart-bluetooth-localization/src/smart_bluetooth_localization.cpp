#include "smart_bluetooth_localization.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "fiona/objects/step.hpp"

namespace fiona::smart_bluetooth_localization {
namespace {

constexpr std::chrono::seconds kOldestReading{3};
constexpr std::chrono::seconds kOldestOrientation{1};
constexpr double kCoarse_m = 1.0;

std::string text_of(beacons::Validity validity) {
  switch (validity) {
    case beacons::Validity::Valid: return "valid";
    case beacons::Validity::NoEvidence: return "no known beacon heard yet";
    case beacons::Validity::Ambiguous: return "ambiguous";
    case beacons::Validity::Unheard: return "no known beacon heard for two minutes";
  }
  return "unknown";
}

/// The map that comes with the package, to try it: no map is a default, for each is of one building.
constexpr const char* kHouse = "house.beacons";

}  // namespace

void SmartBluetoothLocalization::on_start() {
  if (params_->beacons().empty()) {
    throw Error(ErrorCode::Usage, {.what = "no beacon map is named",
                                   .where = name(),
                                   .next = "fiona-beaconmap learn FOLDER -o FILE, or write one by hand; then load "
                                           "smart-bluetooth-localization as " +
                                           name() + " beacons=FILE"});
  }
  std::error_code unknown;
  const bool is_packaged = params_->beacons() == kHouse && !std::filesystem::exists(kHouse, unknown);
  drawn_ = beacons::load(is_packaged ? resource(kHouse) : std::filesystem::path(params_->beacons()));
  beacon_map_ = drawn_;
  make_field();
}

void SmartBluetoothLocalization::check(const SmartBluetoothLocalizationParams& draft) const {
  if (!field_ || draft.beacons() == params_->beacons()) return;
  throw Error(ErrorCode::Usage, {.what = "the beacon map is read when the instance starts",
                                 .where = name() + ".beacons",
                                 .next = "load another instance with beacons=" + draft.beacons() + ", and swap"});
}

/// A map with a survey covers what was surveyed; one written by hand covers what the plan does.
void SmartBluetoothLocalization::make_field() {
  if (beacon_map_.survey().empty()) extents_ = plan_->extents();
  field_ = std::make_shared<const beacons::BeaconField>(beacon_map_, extents_);
  if (field_->cell_m() > kCoarse_m) {
    log(LogLevel::Warning, "the beacon map is so large that places nearer than " +
                               std::to_string(std::lround(field_->cell_m())) + " m are not told apart");
  }
  make_filter();
}

void SmartBluetoothLocalization::make_filter() {
  if (!field_) return;
  beacons::FilterOptions options;
  options.particles = params_->particles();
  options.seed = params_->seed();
  options.walls = params_->walls();
  filter_.emplace(field_, plan_, beacon_map_.accuracy(), beacon_map_.radio().offset(), options);
  note_validity(beacons::Validity::NoEvidence);  // what the one before knew has gone with it
  has_walls_.set(options.walls && plan_->has_walls());
}

/// The times of readings are the scanner's, whose clock may differ: they tell how much older one is than the newest of
/// its list, and whether it has been used. How old the list is, its origin tells.
void SmartBluetoothLocalization::on_beacons(const Received<sensors::CommiBeaconList>& list) {
  std::int64_t newest_ms = std::numeric_limits<std::int64_t>::min();
  for (const auto& beacon : list->beacon_list()) {
    if (beacon.has_t()) newest_ms = std::max(newest_ms, std::int64_t{beacon.t()});
  }
  const beacons::Time age(to_milliseconds(now()) - to_milliseconds(list.origin));
  for (const auto& beacon : list->beacon_list()) {
    if (!beacon.has_rssi()) continue;
    auto number = beacon.address().empty() ? std::nullopt : field_->find(beacon.address());
    if (!number) {
      number =
          field_->find(beacon.uuid() + "/" + std::to_string(beacon.major()) + "/" + std::to_string(beacon.minor()));
    }
    if (!number) {
      unknown_.set(++unknown_readings_);
      continue;
    }
    if (beacon.has_t()) {
      const auto [last, is_first] = last_heard_ms_.try_emplace(*number, beacon.t());
      if (!is_first && std::exchange(last->second, beacon.t()) == beacon.t()) continue;
    }
    if (age + beacons::Time(beacon.has_t() ? newest_ms - beacon.t() : 0) > kOldestReading) {
      old_.set(++old_readings_);
      continue;
    }
    filter_->heard(*number, beacon.rssi());
  }
}

void SmartBluetoothLocalization::on_step(const localisation::CommStep& step) {
  if (!step.is_valid()) return;
  filter_->step({step.length(), localisation::length_sd_m(step), step.heading() + frame_turn_rad_,
                 localisation::heading_sd_rad(step), step.has_rise() ? std::optional(step.rise()) : std::nullopt});
}

void SmartBluetoothLocalization::on_orientation(const Received<localisation::CommOrientation>& orientation) {
  newest_orientation_ = orientation;
}

void SmartBluetoothLocalization::on_map_change(const Fired<navigation::LevelMapVersion>& change) {
  told_version_ = change->version();
  map_wanted_ = true;
}

Async<> SmartBluetoothLocalization::look_for_map() {
  if (!change_told_ && map_change_.connection() == Connection::Connected) {
    // With no version, which each provider's differs from: whoever serves next tells its own at once.
    const auto activated = co_await map_change_.activate(EventMode::Continuous, {});
    change_told_ = activated.outcome() == Outcome::Ok;
  }
  if (!map_wanted_ || map_.connection() != Connection::Connected) co_return;
  told_version_.reset();
  const auto answer = co_await map_.query({});
  if (!answer) {
    log(LogLevel::Warning, "the level map was not told: " + std::string(answer.reason()));
    co_return;
  }
  // One that has changed on the way is asked for again.
  map_wanted_ = told_version_ && *told_version_ != (*answer)->version();
  use(*answer);
}

/// The frame of the level map; none: there is no map, or it does not say.
std::optional<building::Reference> SmartBluetoothLocalization::frame_of_map() const {
  if (!level_map_ || !level_map_->reference().has_reference_lat()) return std::nullopt;
  const localisation::CommPosition& told = level_map_->reference();
  return building::Reference{told.reference_lat(), told.reference_long(),
                             told.reference_heading() * std::numbers::pi / 180.0, true};
}

/// The beacons stay where they are when the building is drawn anew around another origin. Whether anything was moved.
bool SmartBluetoothLocalization::move_beacons() {
  constexpr double kApart_m = 0.001;
  const auto own = beacons::reference_of(drawn_), map = frame_of_map();
  const building::Placement how = own && map ? building::placement_of(*own, *map) : building::Placement();
  const bool is_there =
      building::length_m(how.by - moved_.by) < kApart_m && std::abs(how.turn_rad - moved_.turn_rad) < 1e-6;
  if (is_there) return false;
  moved_ = how;
  beacon_map_ = beacons::moved(drawn_, how);
  log(LogLevel::Info, fmt::format("the origin of the beacon map lies {:.1f} m from that of '{}': its beacons are moved",
                                  building::length_m(how.by), level_map_->name()));
  return true;
}

/// Nobody is found between two levels, whatever lies there.
void SmartBluetoothLocalization::tell_of_levels_between() {
  std::set<double> between;
  for (const auto& room : level_map_->rooms()) {
    if (room.level() != std::round(room.level())) between.insert(room.level());
  }
  if (between.empty()) return;
  log(LogLevel::Warning, fmt::format("positions have whole levels: who is on {} of '{}' is found on one beside it",
                                     fmt::join(between, ", "), level_map_->name()));
}

void SmartBluetoothLocalization::use(std::shared_ptr<const navigation::CommLevelMap> map) {
  if (level_map_ && level_map_->version() == map->version()) return;
  level_map_ = std::move(map);
  frame_turn_rad_ = level_map_->reference().reference_heading() * std::numbers::pi / 180.0;
  try {
    plan_ = std::make_shared<const beacons::FloorPlan>(*level_map_);
  } catch (const Error& error) {
    log(LogLevel::Warning, std::string("walls are left out: ") + error.what());
    plan_ = std::make_shared<const beacons::FloorPlan>();
  }
  log(LogLevel::Info, "walls of '" + level_map_->name() + "' in use: " + std::to_string(level_map_->walls_size()));
  tell_of_levels_between();
  if (move_beacons() || (beacon_map_.survey().empty() && plan_->extents() != extents_)) return make_field();
  filter_->use(plan_);
  has_walls_.set(params_->walls() && plan_->has_walls());
}

void SmartBluetoothLocalization::produce() {
  const TimePoint heard_until = now();
  filter_->expect_steps(steps_.connection() == Connection::Connected);
  filter_->advance(clock_ms());
  const beacons::Estimate estimate = filter_->estimate();
  note_validity(estimate.validity);
  spread_.set(estimate.is_valid() ? std::sqrt(estimate.covariance.trace()) : std::numeric_limits<double>::infinity());
  rssi_offset_.set(estimate.rssi_offset_db);
  heading_bias_.set(estimate.heading_bias_rad);
  location_.put(location_of(estimate), heard_until);
}

localisation::CommLocation SmartBluetoothLocalization::location_of(const beacons::Estimate& estimate) const {
  localisation::CommLocation location;
  auto& position = *location.mutable_position();
  const auto frame = frame_of_map();
  if (const auto in = frame ? frame : beacons::reference_of(drawn_)) {
    position.set_reference_lat(in->latitude_deg);
    position.set_reference_long(in->longitude_deg);
    position.set_reference_heading(in->heading_rad * 180.0 / std::numbers::pi);
  }
  if (newest_orientation_ && (*newest_orientation_)->is_valid() &&
      now() - newest_orientation_->origin <= kOldestOrientation) {
    auto& orientation = *location.mutable_orientation();
    orientation = **newest_orientation_;
    const double yaw = std::remainder(orientation.yaw() + estimate.heading_bias_rad, 2 * std::numbers::pi);
    orientation.set_yaw(yaw < 0 ? yaw + 2 * std::numbers::pi : yaw);
    if (orientation.confidence_size() == 9) {
      orientation.set_confidence(0, orientation.confidence(0) + estimate.heading_bias_variance);
    }
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

/// Says once, each time that it changes, why there is no position.
void SmartBluetoothLocalization::note_validity(beacons::Validity validity) {
  validity_probe_.set(text_of(validity));
  if (validity == validity_) return;
  validity_ = validity;
  if (validity == beacons::Validity::Unheard) {
    log(LogLevel::Warning, "no beacon of the map was heard for two minutes: there is no position until one is");
  }
  if (validity == beacons::Validity::Ambiguous) log(LogLevel::Info, "what is heard fits too many places");
}

}  // namespace fiona::smart_bluetooth_localization
