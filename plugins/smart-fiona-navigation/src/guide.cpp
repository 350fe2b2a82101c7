#include "guide.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <fiona/building/geometry.hpp>

#include "words.hpp"

namespace fiona::guidance {

using building::Passage;
using building::Point;
using hmi::Instruction;
using hmi::NextTurn;
using namespace std::chrono_literals;

namespace {

/// A corner that the place is taken to be on the wrong side of has nobody look aside by more than this.
constexpr double kAway_rad = 120.0 * Situation::kDegree;

/// Who has been told to leave the room that the path begins in is not told of its door before.
std::optional<TimePoint> leaves_until(TimePoint told, const LevelPlan& plan, const Path& path, const Maneuver& first) {
  constexpr auto kLeaves = 10s;
  const building::RoutePoint& start = path.route().points.front();
  const auto room = building::room_index_at(plan.plan, start.at, start.level);
  const bool begins_in_room = room && plan.plan.rooms[*room].kind == building::RoomKind::Room;
  return begins_in_room && first.kind == Instruction::DOOR ? std::optional(told + kLeaves) : std::nullopt;
}

bool leads_to_path(Phase phase) { return phase == Phase::Align || phase == Phase::Join || phase == Phase::Back; }

NextTurn turn_in(double distance_m, NextTurn::TypeOfTurn hour) {
  NextTurn turn;
  turn.set_distance_to_turn(static_cast<std::uint32_t>(std::lround(1000.0 * distance_m)));
  turn.set_type_of_turn(hour);
  return turn;
}

}  // namespace

Guide::Guide(const LevelPlan& plan, building::Route route, std::string destination, bool first, TimePoint now,
             std::optional<TimePoint> leaves)
    : plan_(plan),
      path_(std::move(route)),
      maneuvers_(maneuvers(path_)),
      destination_(std::move(destination)),
      first_(first),
      begun_(now),
      leaves_until_(leaves ? leaves_until(*leaves, plan_, path_, maneuvers_.front()) : std::nullopt),
      tracker_(now),
      progress_(leaves_until_ ? 1 : 0) {}

Guide::Advice Guide::follow(const Walker& walker, TimePoint now) {
  const bool leaves = leaves_until_ && now < *leaves_until_;
  Situation here{plan_, path_, maneuvers_, walker, now, leaves, progress_.next()};
  tracker_.locate(here);
  told_.follow(here);
  Advice advice;
  advice.off_path = here.is_off;
  advice.arrived = here.has_arrived();
  if (!advice.arrived) progress_.follow(here, told_);
  const Word word = choose(here, advice.arrived);
  advice.is_new = told_.last() != word;
  advice.instruction = instruction(word.phase, here);
  advice.turn = turn(word.phase, advice.instruction, here);
  if (advice.is_new) words_ = words(word.phase, advice.instruction, here);
  // Who has begun to walk before there was a way hears of it with the first word.
  if (!told_.last() && leaves_until_) words_ = whole_way() + ". " + words_;
  advice.instruction.set_text(words_);
  told_.note(word, here);
  return advice;
}

/// Who does not do what they were told is told again, of an earlier door, or to go back a little: on the move they are
/// found better.
Word Guide::choose(Situation& here, bool arrived) {
  constexpr auto kRepeat = 5s;  // to who does not move
  constexpr auto kTurnsBack = 4s;
  Word word{arrived ? Phase::Arrived : phase_of(here), here.next, told_.last() ? told_.last()->repeated : 0};
  const bool is_same = told_.last() == word;
  const bool waits = here.waits() || word.phase == Phase::Near;
  const bool stays = is_same && here.now - std::max(here.moved_at, told_.since()) > kRepeat && !arrived && !waits;
  // Whatever they have been told meanwhile.
  const bool is_stuck = here.gets_nowhere && here.stands && !waits;
  if ((stays || is_stuck) && progress_.return_to_door(here)) {
    word = {phase_of(here), here.next, 0};
  } else if (is_same && told_.is_overdue(here)) {
    ++word.repeated;
  } else if (stays && word.repeated > 0 && here.walker.heading_rad) {
    back_ = Back{*here.walker.heading_rad + std::numbers::pi, here.now};
  } else if (stays) {
    ++word.repeated;
  }
  const bool goes_back = back_ && here.now - back_->since < kTurnsBack && word.phase != Phase::Arrived;
  return goes_back ? Word{Phase::Back, here.next, 0} : word;
}

Phase Guide::phase_of(const Situation& here) {
  constexpr double kReach_m = 3.0;  // off the way to it
  const Maneuver& next = here.maneuver();
  constexpr double kNearEnd_m = 2.0, kNoMoreNear_m = 4.0;
  if (starts(here)) return Phase::Start;
  if (here.is_near_end(told_.was(Phase::Near) ? kNoMoreNear_m : kNearEnd_m)) return Phase::Near;
  if (next.changes_level() && here.at_m > next.at_m - 0.3) return Phase::Now;
  // A door that is further than it is told to be is not gone through now.
  const bool out_of_reach = next.is_door() && here.to_spot_m() > here.to_next_m() + kReach_m;
  if (out_of_reach && here.off_m > Situation::kBeside_m && !here.leaves) return Phase::Align;
  // Who was told to go through a door is about to: another word would be taken for another door.
  if (told_.is_doing(here) && next.kind != Instruction::TURN) return Phase::Now;
  const bool was_now = nearness_.maneuver == here.next && nearness_.told == Phase::Now;
  if (was_now && next.is_door() && here.is_at_door()) return Phase::Now;
  const auto rest_rad = here.turn_to(aim(here));
  const bool aligned = is_aligned(here, rest_rad.value_or(0.0));
  if (rest_rad && !here.leaves && joins(here, *rest_rad)) return Phase::Join;
  const bool is_there = here.is_at_maneuver() && here.off_m < std::max(Situation::kBeside_m, here.walker.sigma_m);
  if (!aligned && !is_there && !here.leaves) return Phase::Align;
  return next.kind == Instruction::ARRIVE ? Phase::Ahead : nearness(here);
}

bool Guide::starts(const Situation& here) const {
  constexpr double kStarted_m = 0.8;
  constexpr auto kStartedFor = 4s;
  const bool is_first = first_ && !leaves_until_ && (!told_.last() || told_.was(Phase::Start));
  return is_first && here.at_m < kStarted_m && here.now - begun_ < kStartedFor;
}

/// A place that is less than sure has one look elsewhere for a moment.
bool Guide::is_aligned(const Situation& here, double rest_rad) {
  constexpr auto kAstrayFor = 1s;
  if (std::abs(rest_rad) < Situation::kAlong_rad) alignment_.holds = true;
  if (std::abs(rest_rad) <= Situation::kAstray_rad) {
    alignment_.astray_since.reset();
  } else {
    if (!alignment_.astray_since) alignment_.astray_since = here.now;
    const bool is_sure = here.walker.is_sure() || std::abs(rest_rad) > kAway_rad;
    if (is_sure || here.now - *alignment_.astray_since >= kAstrayFor) alignment_.holds = false;
  }
  return alignment_.holds;
}

/// Who was led back to the path, and comes to it across, is told in time to turn along it; at the path they would walk
/// past it.
bool Guide::joins(const Situation& here, double rest_rad) const {
  constexpr double kOnPath_m = 0.3;  // nearer they are on it
  const bool is_near = here.off_m < Situation::kNow_m && here.to_next_m() > 1.0;
  if (!is_near || path_.passage(here.at_m) != Passage::Walk) return false;
  const auto along_rad = here.turn_to(path_.direction(here.at_m));
  if (!along_rad || std::abs(*along_rad) <= Situation::kAstray_rad || std::abs(*along_rad) >= kAway_rad) return false;
  if (told_.was(Phase::Join) && here.now - told_.since() < Told::kDoes) return true;
  return told_.has_led_back(here.now) && std::abs(rest_rad) < Situation::kAlong_rad && here.off_m > kOnPath_m;
}

/// What has been announced, or said to be now, stays so: said again it would be taken for another one.
Phase Guide::nearness(const Situation& here) {
  constexpr double kAnnounced_m = 6.0;
  if (nearness_.maneuver != here.next) nearness_ = {here.next, Phase::Ahead};
  Phase& told = nearness_.told;
  const double ahead_m = here.to_next_m();
  const double back_m = 1.0 + 2.0 * here.walker.sigma_m;
  // So near there is no time for two sentences.
  const bool late = told == Phase::Ahead && ahead_m <= Situation::kNow_m + 1.0;
  if (ahead_m <= Situation::kNow_m || late) {
    told = Phase::Now;
  } else if (ahead_m <= kAnnounced_m && (told != Phase::Now || ahead_m > Situation::kNow_m + back_m)) {
    told = Phase::Announced;
  } else if (ahead_m > kAnnounced_m + back_m) {
    told = Phase::Ahead;
  }
  return told;
}

/// The direction to walk in now.
Point Guide::aim(const Situation& here) const {
  constexpr double kAtFoot_m = 0.5;  // of stairs
  const Maneuver& next = here.maneuver();
  const Point at = here.walker.place.at;
  if (next.changes_level() && next.out != Point{} && here.is_at_maneuver()) {
    if (here.off_m > std::max(Situation::kBeside_m, here.walker.sigma_m)) return building::unit(here.spot() - at);
    // Where a flight ends says nothing of where it begins.
    return here.at_m < next.at_m + kAtFoot_m ? next.out : path_.direction(here.at_m);
  }
  if (progress_.is_shut(here) && here.at_m > next.at_m - 0.5 && next.out != Point{}) return next.out;
  // A door that was missed is behind.
  if (next.is_door() && told_.has_missed(here) && !here.walled(at, here.spot()))
    return building::unit(here.spot() - at);
  return ahead(here);
}

/// To a place of the path a little ahead that is in sight: not beyond the next maneuver, before one is there.
Point Guide::ahead(const Situation& here) const {
  constexpr double kLookAhead_m = 2.5;
  constexpr double kHeldUp_m = 0.5;     // beside the path
  constexpr double kMayBeOnPath = 2.0;  // so many standard deviations away from it
  const Maneuver& next = here.maneuver();
  const Point at = here.walker.place.at;
  const bool is_there = here.is_at_maneuver();
  // Who stands beside the path has a corner of a wall before them: back to the path first.
  const bool held_up = here.stands && here.off_m > kHeldUp_m;
  const double ahead_m = held_up ? kHeldUp_m : kLookAhead_m;
  const double far_m =
      is_there ? std::min(next.end_m + ahead_m, path_.end_m()) : std::min(here.at_m + ahead_m, next.at_m);
  // Who may as well be on the path is taken to be there, unless a wall is in the way beside it.
  const Point on_path = path_.place(here.at_m).at;
  const bool as_if_on_path = !held_up && here.off_m < kMayBeOnPath * here.walker.sigma_m &&
                             !here.walled(at, at + (path_.place(far_m).at - on_path));
  const Point from = as_if_on_path ? on_path : at;
  for (const double to_m : {far_m, (here.at_m + far_m) / 2.0, here.at_m}) {
    const Point to = path_.place(to_m).at;
    if (distance_m(from, to) < 0.3 || here.walled(from, to)) continue;
    return building::unit(to - from);
  }
  return is_there && next.out != Point{} ? next.out : path_.direction(here.at_m);
}

NextTurn::TypeOfTurn Guide::hour(Phase phase, const Situation& here) const {
  if (phase == Phase::Arrived) return NextTurn::TYPE_OF_TURN_UNSPECIFIED;
  if (phase == Phase::Join) return hour_of(here.turn_to(path_.direction(here.at_m)).value_or(0.0));
  if (phase != Phase::Back) return hour_ahead(phase, here);
  const double looks_rad = here.walker.heading_rad.value_or(back_->heading_rad);
  return hour_of(std::remainder(back_->heading_rad - looks_rad, 2.0 * std::numbers::pi));
}

NextTurn::TypeOfTurn Guide::hour_ahead(Phase phase, const Situation& here) const {
  constexpr double kAsTold_rad = 22.5 * Situation::kDegree;
  const Maneuver& next = here.maneuver();
  const bool turns_later = phase == Phase::Announced || (phase == Phase::Now && here.to_next_m() >= 1.0);
  const bool turns_now = phase == Phase::Now && next.kind == Instruction::TURN;
  const Point to = turns_later ? next.out : aim(here);
  if (to == Point{}) return NextTurn::TYPE_OF_TURN_UNSPECIFIED;
  if (phase == Phase::Ahead && here.leaves) return NextTurn::HOUR_12;
  const bool at_turn = turns_later || turns_now;
  const Point along = path_.direction(std::max(0.0, at_turn ? next.at_m - 0.1 : here.at_m));
  // Walls lead better than a compass among them: who walks about along the way is taken to walk along it, and turns by
  // as much as it does.
  if (at_turn && !here.walker.is_sure() && next.out != Point{} && here.looks_along(along))
    return hour_of(clockwise_rad(along, next.out));
  if (const auto rest_rad = here.turn_to(to)) {
    // Who walks about where they were told to is not corrected by what a compass may err, for one hears whole hours.
    const bool walks_there = phase == Phase::Ahead || (turns_now && told_.to_do_next(here));
    const bool is_as_told = walks_there && !here.walker.is_sure() && std::abs(*rest_rad) < kAsTold_rad;
    return is_as_told ? NextTurn::HOUR_12 : hour_of(*rest_rad);
  }
  // Not known where the walker looks: along the path.
  return along == Point{} ? NextTurn::TYPE_OF_TURN_UNSPECIFIED : hour_of(clockwise_rad(along, to));
}

Instruction Guide::instruction(Phase phase, const Situation& here) const {
  const Maneuver& next = here.maneuver();
  const bool is_here = leads_to_path(phase) || phase == Phase::Start || phase == Phase::Arrived;
  Instruction made;
  made.set_kind(phase == Phase::Arrived                         ? Instruction::ARRIVE
                : phase == Phase::Start                         ? Instruction::START
                : leads_to_path(phase)                          ? Instruction::TURN
                : phase == Phase::Ahead || phase == Phase::Near ? Instruction::CONTINUE
                                                                : next.kind);
  made.set_distance(phase == Phase::Join ? here.off_m : is_here ? 0.0 : here.to_next_m());
  made.set_hour(hour(phase, here));
  made.set_level(path_.place(is_here ? here.at_m : next.at_m).level);
  made.set_language("en");
  if (phase != Phase::Now && phase != Phase::Announced) return made;
  if (next.to_level) made.set_to_level(*next.to_level);
  const auto turn_rad = here.then_rad();
  if (turn_rad && hour_of(*turn_rad) != NextTurn::HOUR_12) made.set_then_hour(hour_of(*turn_rad));
  return made;
}

NextTurn Guide::turn(Phase phase, const Instruction& told, const Situation& here) const {
  if (phase == Phase::Start || leads_to_path(phase)) return turn_in(told.distance(), told.hour());
  if (phase == Phase::Arrived || here.maneuver().out == Point{}) return {};
  return turn_in(here.to_next_m(), phase == Phase::Ahead ? hour(Phase::Announced, here) : told.hour());
}

std::string Guide::words(Phase phase, const Instruction& told, const Situation& here) const {
  const Maneuver& next = here.maneuver();
  const bool is_straight = told.hour() == NextTurn::HOUR_12;
  const bool is_around = told.hour() == NextTurn::HOUR_6;
  const std::string direction = direction_words(told.hour());
  const std::string far = metres(here.to_next_m());
  switch (phase) {
    case Phase::Arrived: return "You have arrived: " + destination_ + ".";
    case Phase::Start:
      return whole_way() + ": " +
             (is_around     ? "turn around"
              : is_straight ? "go straight on"
                            : "turn " + direction) +
             ".";
    case Phase::Back: return "You do not get on there. Turn around, and walk some steps.";
    case Phase::Align:
      return is_around     ? "Turn around."
             : is_straight ? "Go straight on to the path."
                           : "Turn " + direction + " to the path.";
    case Phase::Join: return "Turn " + direction + " now.";
    case Phase::Near: return "You should be near " + destination_ + ". It is not sure where you are.";
    case Phase::Ahead:
      return next.kind == Instruction::ARRIVE ? "Go on for " + far + " to " + destination_ + "."
                                              : "Go straight on for " + far + ".";
    default: break;
  }
  const std::string todo =
      maneuver_words(plan_.plan, next, told.hour(), path_.place(next.at_m).level,
                     phase == Phase::Now ? std::nullopt : std::optional(here.to_next_m()), told.then_hour());
  // Who waits at its door is to know that it is a lift.
  if (!here.is_lift_door()) return todo;
  return todo + " Behind it is the lift to " + level_words(plan_.plan, *maneuvers_[here.next + 1].to_level) + ".";
}

std::string Guide::whole_way() const { return "To " + destination_ + ", " + metres(path_.route().length_m); }

}  // namespace fiona::guidance
