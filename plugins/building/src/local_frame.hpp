#pragma once

#include <cmath>

#include <GeographicLib/LocalCartesian.hpp>

#include "fiona/building/building.hpp"

namespace fiona::building {

/// WGS84 to the local frame and back: the tangent plane at the reference, turned so that y points along its
/// heading.
class LocalFrame {
 public:
  explicit LocalFrame(const Reference& reference)
      : plane_(reference.latitude_deg, reference.longitude_deg, 0.0),
        sine_(std::sin(reference.heading_rad)),
        cosine_(std::cos(reference.heading_rad)) {}

  Point to_local(const Wgs84& place) const {
    double east_m = 0.0, north_m = 0.0, up_m = 0.0;
    plane_.Forward(place.latitude_deg, place.longitude_deg, 0.0, east_m, north_m, up_m);
    return {east_m * cosine_ - north_m * sine_, east_m * sine_ + north_m * cosine_};
  }

  Wgs84 to_wgs84(Point p) const {
    const double east_m = p.x_m * cosine_ + p.y_m * sine_;
    const double north_m = p.y_m * cosine_ - p.x_m * sine_;
    Wgs84 place;
    double height_m = 0.0;
    plane_.Reverse(east_m, north_m, 0.0, place.latitude_deg, place.longitude_deg, height_m);
    // The ground that to_local() projects onto this point, not the ground plumb below it: beside the reference the
    // plane is above the earth, and the two are millimetres apart at 5 km.
    plane_.Reverse(east_m, north_m, -height_m, place.latitude_deg, place.longitude_deg, height_m);
    return place;
  }

 private:
  GeographicLib::LocalCartesian plane_;
  double sine_;
  double cosine_;
};

}  // namespace fiona::building
