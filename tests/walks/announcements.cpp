#include "announcements.hpp"

#include <algorithm>
#include <cmath>

namespace fiona::walks {
namespace {

using hmi::Instruction;

constexpr double kSameMark_m = 2.0;

std::optional<Mark::Kind> kind_of(const Instruction& said) {
  switch (said.kind()) {
    case Instruction::TURN: return Mark::Kind::Turn;
    case Instruction::DOOR:
    case Instruction::ENTER:
    case Instruction::LEAVE: return Mark::Kind::Door;
    case Instruction::STAIRS:
    case Instruction::ESCALATOR:
    case Instruction::RAMP:
    case Instruction::LIFT: return Mark::Kind::Climb;
    default: return std::nullopt;
  }
}

/// Only its words tell that it is no turn of the path.
bool is_to_the_path(const Instruction& said) {
  return said.kind() == Instruction::TURN &&
         (said.text().ends_with("to the path.") || said.text().find("urn around") != std::string::npos);
}

bool is_about(const std::optional<double>& told_m, double wanted_m, double within_m) {
  return told_m && std::abs(*told_m - wanted_m) <= within_m;
}

std::string words(const std::optional<double>& told_m) {
  return told_m ? "at " + std::to_string(*told_m) + " m" : "never";
}

}  // namespace

std::string Announcement::fault() const {
  if (held_up || (is_about(first_m, 6.0, 2.0) && is_about(again_m, 2.0, 1.0))) return {};
  return "walked " + std::to_string(mark.leg_m) + " m to what was announced " + words(first_m) + " and told again " +
         words(again_m);
}

Announcements::Announcements(const std::vector<Mark>& marks) {
  for (const Mark& mark : marks) {
    if (mark.leg_m >= kLeg_m) ahead_.push_back({.told = {.mark = mark}});
  }
}

void Announcements::walk(double truly_m) {
  for (Ahead& one : ahead_) {
    if (truly_m < one.told.mark.at_m - kLeg_m + 0.5) one.walked_up_to = true;
    if (truly_m >= one.told.mark.at_m - 0.1) one.passed = true;
  }
}

void Announcements::hear(const Instruction& said, double believed_m, double truly_m) {
  for (Ahead& one : ahead_) {
    Announcement& told = one.told;
    const double left_m = told.mark.at_m - believed_m;
    if (is_to_the_path(said)) {
      told.held_up = told.held_up || (left_m > 0.0 && left_m < kLeg_m);
    } else if (kind_of(said) != told.mark.kind || std::abs(said.distance() - left_m) > kSameMark_m) {
      continue;
    } else if (!told.first_m) {
      told.first_m = said.distance();
      told.truly_first_m = told.mark.at_m - truly_m;
    } else if (!told.again_m) {
      told.again_m = said.distance();
      told.truly_again_m = told.mark.at_m - truly_m;
    }
  }
}

std::vector<Announcement> Announcements::take_passed() {
  std::vector<Announcement> passed;
  for (const Ahead& one : ahead_) {
    if (one.passed && one.walked_up_to) passed.push_back(one.told);
  }
  std::erase_if(ahead_, [](const Ahead& one) { return one.passed; });
  return passed;
}

}  // namespace fiona::walks
