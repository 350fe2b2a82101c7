#pragma once

#include <optional>
#include <string>
#include <vector>

#include <fiona/hmi.pb.h>
#include <fiona/navigation.pb.h>
#include <fiona/building/building.hpp>

#include "measured_path.hpp"

namespace fiona::walks {

/// Where guidance takes the walker to be, and to look.
struct Believed {
  building::PathPoint place{};
  std::optional<double> heading_rad{};  ///< clockwise from true north
  double sigma_m = 0.0;                 ///< of the place, along its longer axis
  bool is_sure() const { return sigma_m < 0.3; }
};

/// Holds paths and words against the drawing: none may lead across a wall, nor where the profile forbids it.
class WordCheck {
 public:
  WordCheck(const building::Building& building, const building::RouteOptions& profile)
      : building_(building), profile_(profile) {}

  /// What is wrong with a path; empty: nothing.
  std::string fault_of(const navigation::CommPath& path) const;
  /// What is wrong with a word to one who is believed to be there, `at_m` along the path; empty: nothing.
  std::string fault_of(const hmi::Instruction& said, const Believed& walker, const MeasuredPath& path,
                       double at_m) const;

 private:
  std::string fault_at(const localisation::CommPosition& place) const;
  std::string fault_between(const localisation::CommPosition& from, const localisation::CommPosition& to) const;
  std::string fault_of_climb(building::Point from, building::Point to) const;
  std::string fault_of_door(const hmi::Instruction& said, const Believed& walker, const MeasuredPath& path,
                            double at_m) const;
  bool is_walled_off(const Believed& walker, const MeasuredPath& path, double at_m) const;
  bool is_shut(const building::Door& door) const;
  bool leads_into_wall(const hmi::Instruction& said, const Believed& walker, const MeasuredPath& path,
                       double at_m) const;
  std::vector<double> looks_rad(const Believed& walker, building::Point along) const;
  bool is_free(const building::PathPoint& from, double bearing_rad, double wanted_m) const;

  const building::Building& building_;
  const building::RouteOptions profile_;
};

}  // namespace fiona::walks
