#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "fiona/component.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/radio_localisation/params.pb.h"
#include "fiona/sensors.fiona.hpp"
#include "radio_filter.hpp"

namespace fiona::radio_localisation {

/// Positions from Wi-Fi and iBeacons against a radio map, with steps in between.
class RadioLocalisation final : public Component {
 public:
  using Component::Component;
  void on_start() override;

 private:
  void check(const RadioLocalisationParams& draft) const;
  void on_wifi(const Received<sensors::RFSignalRSSI>& signal);
  void on_beacons(const Received<sensors::CommiBeaconList>& beacons);
  void use_row(const std::string& id, radio::Radio radio, double rssi_dbm, TimePoint heard);
  void on_step(const Received<localisation::CommStep>& step);
  void produce();
  void note_validity(radio::Validity validity);
  void show(const radio::Estimate& estimate);
  radio::Time clock_ms() const { return radio::Time(to_milliseconds(now())); }

  Params<RadioLocalisationParams> params_{*this, &RadioLocalisation::check};
  Requires<sensors::RFSignalRSSIService> wifi_{
      *this, "wifi", &RadioLocalisation::on_wifi, {.doc = "rows of Wi-Fi scans, each with the time it was heard"}};
  Requires<sensors::IbeaconlistProvider> beacons_{
      *this, "beacons", &RadioLocalisation::on_beacons, {.optional = true, .doc = "iBeacons in range"}};
  Requires<localisation::StepProvider> steps_{
      *this, "steps", &RadioLocalisation::on_step, {.optional = true, .doc = "how the person moves between the scans"}};
  Provides<localisation::LocationProvider> location_{*this, "location", &RadioLocalisation::produce};

  Probe<double> spread_{
      *this, "spread", {.unit = "m", .doc = "standard deviation of the position; infinite while there is none"}};
  Probe<double> known_share_{
      *this, "known_share", {.doc = "of the transmitters heard lately, those that the radio map knows"}};
  Probe<std::uint64_t> old_{*this, "old_rows", {.doc = "rows that were told too long after they had been heard"}};
  Probe<std::string> validity_probe_{*this, "validity", {.doc = "whether there is a position, or why not"}};

  std::shared_ptr<const radio::RadioMap> map_;
  std::optional<radio::RadioFilter> filter_;
  radio::Validity validity_ = radio::Validity::NoEvidence;
  std::uint64_t old_rows_ = 0;
  std::map<std::string, std::int64_t> told_;  ///< when the newest list's beacons were heard: lists repeat them
};

}  // namespace fiona::radio_localisation
