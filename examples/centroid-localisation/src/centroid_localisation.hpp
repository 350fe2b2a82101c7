#pragma once

#include <map>
#include <optional>
#include <string>

#include <fiona/component.hpp>
#include <fiona/localisation.fiona.hpp>
#include <fiona/sensors.fiona.hpp>

#include "acme/centroid_localisation/params.pb.h"

namespace acme::centroid_localisation {

/// A location is the mean of the places of the beacons that are heard, weighted by how near each seems: Blumenthal,
/// Grossmann, Golatowski, Timmermann, "Weighted Centroid Localization in Zigbee-based Sensor Networks" (WISP 2007). It
/// needs no survey and keeps no state but the last seconds' readings, so it is worse than a filter, never lost for
/// long, and done in a page.
class CentroidLocalisation final : public fiona::Component {
 public:
  using Component::Component;

  /// Without a file it runs, and says that no location is valid. Throws fiona::Error if there is one and it cannot be
  /// read.
  void on_start() override;

 private:
  struct Place {
    double x_m, y_m;
    int level;
    double power_dbm;  ///< at 1 m
  };
  struct Reading {
    double rssi_dbm;
    fiona::TimePoint heard;
  };
  /// Of the beacons of one level: the sums of weights, and of places and squares by weight.
  struct Sums {
    double weight = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0, yy = 0.0, squares = 0.0;
  };

  void on_beacons(const fiona::sensors::CommiBeaconList& list);
  void on_orientation(const fiona::Received<fiona::localisation::CommOrientation>& orientation);
  void produce_location();
  std::map<int, Sums> sums() const;

  std::map<std::string, Place> places_;
  std::map<std::string, Reading> readings_;  ///< at most one for each place
  std::optional<fiona::Received<fiona::localisation::CommOrientation>> orientation_;

  fiona::Params<Params> params_{*this};
  fiona::Provides<fiona::localisation::LocationProvider> location_{*this, "location",
                                                                   &CentroidLocalisation::produce_location};
  fiona::Requires<fiona::sensors::IbeaconlistProvider> beacons_in_{*this, "beacons", &CentroidLocalisation::on_beacons};
  fiona::Requires<fiona::localisation::OrientationProvider> orientation_in_{
      *this, "orientation", &CentroidLocalisation::on_orientation, {.optional = true}};
  fiona::Probe<std::uint64_t> heard_{*this, "heard", {.doc = "beacons of the file that were heard within the window"}};
};

}  // namespace acme::centroid_localisation
