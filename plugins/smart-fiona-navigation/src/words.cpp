#include "words.hpp"

#include <cctype>
#include <cmath>
#include <numbers>

#include <fiona/building/levels.hpp>

namespace fiona::guidance {

using hmi::Instruction;
using hmi::NextTurn;

NextTurn::TypeOfTurn hour_of(double clockwise_rad) {
  const long twelfths = std::lround(clockwise_rad / (std::numbers::pi / 6.0));
  const int hour = static_cast<int>((twelfths % 12 + 12) % 12);
  return static_cast<NextTurn::TypeOfTurn>(hour == 0 ? 12 : hour);
}

std::string direction_words(NextTurn::TypeOfTurn hour) {
  switch (hour) {
    case NextTurn::HOUR_1: return "slightly right";
    case NextTurn::HOUR_2:
    case NextTurn::HOUR_3: return "right";
    case NextTurn::HOUR_4:
    case NextTurn::HOUR_5: return "sharp right";
    case NextTurn::HOUR_6: return "back";
    case NextTurn::HOUR_7:
    case NextTurn::HOUR_8: return "sharp left";
    case NextTurn::HOUR_9:
    case NextTurn::HOUR_10: return "left";
    case NextTurn::HOUR_11: return "slightly left";
    default: return "straight on";
  }
}

std::string metres(double length_m) { return std::to_string(std::lround(length_m)) + " m"; }

std::string level_words(const building::Plan& plan, double level) {
  for (const building::Level& one : plan.levels) {
    if (one.level == level && !one.name.empty()) return one.name;
  }
  return "level " + building::level_text(level);
}

namespace {

std::string act_words(const building::Plan& plan, const Maneuver& maneuver, NextTurn::TypeOfTurn hour, double level) {
  const bool straight = hour == NextTurn::HOUR_12 || hour == NextTurn::TYPE_OF_TURN_UNSPECIFIED;
  const std::string to = maneuver.to_level ? " to " + level_words(plan, *maneuver.to_level) : "";
  const double rise = maneuver.to_level ? *maneuver.to_level - level : maneuver.rise;
  const std::string up = rise > 0 ? " up" : rise < 0 ? " down" : "";
  const std::string aside = straight ? "" : "turn " + direction_words(hour) + " and ";
  switch (maneuver.kind) {
    case Instruction::TURN: return straight ? "go straight on" : "turn " + direction_words(hour);
    case Instruction::DOOR: return aside + "go through the door";
    case Instruction::ENTER: return aside + "go through the door into the building";
    case Instruction::LEAVE: return aside + "go through the door out of the building";
    case Instruction::STAIRS: return aside + "take the stairs" + up + to;
    case Instruction::ESCALATOR: return aside + "take the escalator" + up + to;
    case Instruction::RAMP: return aside + "take the ramp" + up + to;
    case Instruction::LIFT: return "take the lift" + to;
    default: return "go on";
  }
}

}  // namespace

std::string maneuver_words(const building::Plan& plan, const Maneuver& maneuver, NextTurn::TypeOfTurn hour,
                           double level, std::optional<double> distance_m, NextTurn::TypeOfTurn then) {
  std::string words = act_words(plan, maneuver, hour, level);
  if (then != NextTurn::TYPE_OF_TURN_UNSPECIFIED) words += ", then turn " + direction_words(then);
  if (distance_m) return "In " + metres(*distance_m) + " " + words + ".";
  words.front() = static_cast<char>(std::toupper(static_cast<unsigned char>(words.front())));
  return words + (maneuver.kind == Instruction::TURN ? " now." : ".");
}

}  // namespace fiona::guidance
