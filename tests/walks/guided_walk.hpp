#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <fiona/building/building.hpp>

#include "announcements.hpp"

namespace fiona::walks {

/// Who is led, from where to where: drawn from a seed.
struct Errand {
  std::uint64_t seed = 0;
  const building::Room* from = nullptr;
  const building::Room* to = nullptr;
  building::RouteOptions profile{};
  double route_s = 0.0;  ///< that the quickest way takes
  std::string text() const;
};

/// A way of 15 m at least that the profile allows. The building must outlive it.
Errand draw_errand(const building::Building& building, std::uint64_t seed);

struct Outcome {
  /// Within 2 m of the right door, on its level, within 1.5 times the route's time, and never told to be elsewhere.
  bool arrived = false;
  bool told_so = false;               ///< to have arrived, there or in the room, within twice the route's time
  std::optional<double> at_door_s{};  ///< when the door was reached
  std::string ending{};               ///< what happened, in a few words
  double took_s = 0.0;
  int reroutes = 0;
  std::vector<std::string> faults{};          ///< instructions and paths that must not be
  std::vector<std::string> untimely{};        ///< what was announced too early, too late, or only once
  std::uint64_t instructions = 0;             ///< a hash of all that was said, and when
  std::vector<double> errors_m{};             ///< of the localisation, once a second from when the destination was sent
  int inside = 0;                             ///< seconds within the 95 % region of the place
  int wrong_level = 0, unplaced = 0;          ///< seconds with a place on another level, and without a place
  std::vector<Announcement> announcements{};  ///< of the marks that they walked up to
  std::vector<std::string> course{};  ///< second by second where they were and were taken to be; what they were told
};

enum class Guidance {
  Whole,
  Muted,  ///< the walker hears that there is an instruction, and nothing of where to
};

/// What the person is led by.
enum class Place {
  Truth,
  Start,    ///< where they began, for ever
  Beacons,  ///< smart-bluetooth-localization by a map learnt from a survey
};

/// Leads a simulated person through the building, on virtual time. `beacons`: the map's file, where they are led by it.
Outcome lead(const building::Building& building, const std::string& file, const Errand& errand, Guidance guidance,
             Place place = Place::Truth, const std::string& beacons = {});

}  // namespace fiona::walks
