#pragma once

#include <optional>
#include <string>

#include <fiona/hmi.pb.h>
#include <fiona/building/plan.hpp>

#include "maneuvers.hpp"

namespace fiona::guidance {

/// The hour on a clock face for a direction, clockwise from where the walker looks.
hmi::NextTurn::TypeOfTurn hour_of(double clockwise_rad);

/// "right", "slightly left", "back"; of hour 12 and of one that is not known "straight on".
std::string direction_words(hmi::NextTurn::TypeOfTurn hour);

/// "6 m"
std::string metres(double length_m);

/// "First Floor", else "level 1".
std::string level_words(const building::Plan& plan, double level);

/// What to do at a maneuver, in one sentence. `distance_m`: to where it is to be done; nothing: now. `then`: where to
/// turn right behind it.
std::string maneuver_words(const building::Plan& plan, const Maneuver& maneuver, hmi::NextTurn::TypeOfTurn hour,
                           double level, std::optional<double> distance_m,
                           hmi::NextTurn::TypeOfTurn then = hmi::NextTurn::TYPE_OF_TURN_UNSPECIFIED);

}  // namespace fiona::guidance
