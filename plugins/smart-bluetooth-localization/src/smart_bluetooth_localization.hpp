#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "beacon_filter.hpp"
#include "fiona/component.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/sensors.fiona.hpp"
#include "fiona/smart_bluetooth_localization/params.pb.h"

namespace fiona::smart_bluetooth_localization {

/// Positions from iBeacons whose map is known, with steps in between and walls around.
class SmartBluetoothLocalization final : public Component {
 public:
  using Component::Component;
  void on_start() override;

 private:
  void on_beacons(const Received<sensors::CommiBeaconList>& beacons);
  void on_step(const localisation::CommStep& step);
  void on_orientation(const Received<localisation::CommOrientation>& orientation);
  void on_map_change(const Fired<navigation::LevelMapVersion>& change);
  Async<> look_for_map();
  void use(std::shared_ptr<const navigation::CommLevelMap> map);
  std::optional<building::Reference> frame_of_map() const;
  bool move_beacons();
  void tell_of_levels_between();
  void check(const SmartBluetoothLocalizationParams& draft) const;
  void make_field();
  void make_filter();
  void produce();
  localisation::CommLocation location_of(const beacons::Estimate& estimate) const;
  void note_validity(beacons::Validity validity);
  beacons::Time clock_ms() const { return beacons::Time(to_milliseconds(now())); }

  Params<SmartBluetoothLocalizationParams> params_{*this, &SmartBluetoothLocalization::check,
                                                   &SmartBluetoothLocalization::make_filter};
  Requires<sensors::IbeaconlistProvider> beacons_{
      *this, "beacons", &SmartBluetoothLocalization::on_beacons, {.doc = "iBeacons in range"}};
  Requires<localisation::StepProvider> steps_{
      *this,
      "steps",
      &SmartBluetoothLocalization::on_step,
      {.optional = true, .doc = "how the person moves; without it the filter lets the position diffuse"}};
  Requires<localisation::OrientationProvider> orientation_{
      *this,
      "orientation",
      &SmartBluetoothLocalization::on_orientation,
      {.optional = true,
       .doc = "how the device is turned; goes into the location, less the bias that the walk showed"}};
  Requires<navigation::LevelMap> map_{
      *this, "levels", {.optional = true, .doc = "walls, rooms and stairs; without it nothing holds a walker back"}};
  Requires<navigation::LevelMapChange> map_change_{
      *this,
      "map_change",
      &SmartBluetoothLocalization::on_map_change,
      {.optional = true, .doc = "that the map is another one; without it the first is kept"}};
  Provides<localisation::LocationProvider> location_{*this, "location", &SmartBluetoothLocalization::produce};

  Probe<double> spread_{
      *this, "spread", {.unit = "m", .doc = "standard deviation of the position; infinite while there is none"}};
  Probe<double> rssi_offset_{
      *this, "rssi_offset", {.unit = "dB", .doc = "this receiver's readings above the survey's"}};
  Probe<double> heading_bias_{*this, "heading_bias", {.unit = "rad", .doc = "to be added to the steps' headings"}};
  Probe<std::uint64_t> unknown_{*this, "unknown_beacons", {.doc = "readings of beacons that are not in the map"}};
  Probe<std::uint64_t> old_{*this, "old_readings", {.doc = "readings that came too late to be used"}};
  Probe<bool> has_walls_{*this, "has_walls", {.doc = "whether a level map is in use"}};
  Probe<std::string> validity_probe_{*this, "validity", {.doc = "whether there is a position, or why not"}};
  Task look_{*this, "look_for_map", std::chrono::milliseconds(1000), &SmartBluetoothLocalization::look_for_map};

  beacons::BeaconMap drawn_;       ///< as the file has it
  beacons::BeaconMap beacon_map_;  ///< the same in the frame of the level map
  building::Placement moved_;
  std::shared_ptr<const beacons::BeaconField> field_;
  std::vector<beacons::Extent> extents_;  ///< of the plan, as far as the field reaches by it
  std::shared_ptr<const beacons::FloorPlan> plan_ = std::make_shared<const beacons::FloorPlan>();
  std::shared_ptr<const navigation::CommLevelMap> level_map_;
  double frame_turn_rad_ = 0.0;  ///< of the map's y axis, clockwise from true north, which steps are told against
  std::optional<beacons::BeaconFilter> filter_;
  std::map<std::uint32_t, std::int64_t> last_heard_ms_;
  std::optional<Received<localisation::CommOrientation>> newest_orientation_;
  beacons::Validity validity_ = beacons::Validity::NoEvidence;
  std::uint64_t unknown_readings_ = 0, old_readings_ = 0;
  bool map_wanted_ = true, change_told_ = false;
  std::optional<std::uint64_t> told_version_{};  ///< of a map that has changed since it was asked for
};

}  // namespace fiona::smart_bluetooth_localization
