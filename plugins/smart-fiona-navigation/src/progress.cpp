#include "progress.hpp"

#include <algorithm>
#include <cmath>

#include <fiona/building/geometry.hpp>

namespace fiona::guidance {

using building::Point;
using hmi::Instruction;
using namespace std::chrono_literals;

namespace {

constexpr double kBeforeEnd_m = 0.2;  // there a door is as good as passed

bool has_changed_level(const Situation& here) {
  const Maneuver& next = here.maneuver();
  return here.at_m >= next.end_m - 0.4 && std::abs(here.walker.place.level - *next.to_level) < 0.3;
}

bool has_taken_turn(const Situation& here) {
  const Maneuver& turn = here.maneuver();
  const double before_m = std::max(0.7, 1.2 * here.walker.sigma_m);
  return here.at_m > turn.end_m + 0.5 + 2.0 * here.walker.sigma_m ||
         (here.at_m > turn.at_m - before_m && here.looks_along(turn.out));
}

}  // namespace

void Progress::follow(Situation& here, const Told& told) {
  const bool leaves = here.leaves && here.next == 1;
  if (!leaves) go_back(here);
  while (here.next + 1 < here.maneuvers.size() && !told.reacts(here) && has_passed(here, told)) ++here.next;
  if (here.next != next_) passed_at_ = here.now;
  next_ = here.next;
}

void Progress::go_back(Situation& here) {
  constexpr double kMostUnsure_m = 2.0;
  constexpr auto kThroughDoor = 2s;
  const auto last = [&]() -> const Maneuver& { return here.maneuvers[here.next - 1]; };
  const double unsure_m = std::min(here.walker.sigma_m, kMostUnsure_m);
  while (here.next > 0 && here.at_m < last().at_m - Situation::kNow_m - unsure_m) --here.next;
  if (here.next == 0 || here.at_m >= last().end_m - kBeforeEnd_m - unsure_m) return;
  // Who seemed to go through a door and still stands before it is told of the door again; who has gone on beside it, at
  // once: what is behind it lies behind a wall.
  const bool is_beside = here.walker.is_sure() && last().is_door() && !here.is_in_front_of(last());
  if (is_beside || here.now - passed_at_ > kThroughDoor) shut_ = Shut{--here.next, here.walker.place.at, here.now};
}

bool Progress::return_to_door(Situation& here) {
  constexpr double kMostBehind_m = 3.5;
  constexpr auto kShutFor = 30s;
  for (std::size_t i = here.next; i-- > 0 && here.at_m < here.maneuvers[i].end_m + kMostBehind_m;) {
    const bool was_shut = shut_ && shut_->door == i && here.now - shut_->since < kShutFor;
    if (here.maneuvers[i].kind != Instruction::DOOR || was_shut) continue;
    next_ = here.next = i;
    shut_ = Shut{i, here.walker.place.at, here.now};
    passed_at_ = here.now;
    return true;
  }
  return false;
}

bool Progress::has_passed(const Situation& here, const Told& told) const {
  if (here.maneuver().changes_level()) return has_changed_level(here);
  return here.maneuver().kind == Instruction::TURN ? has_taken_turn(here) : is_through(here, told);
}

bool Progress::is_through(const Situation& here, const Told& told) const {
  constexpr double kThrough_m = 1.0;  // on, from where they seemed to be
  constexpr double kClear_m = 0.5;    // of the door
  constexpr double kClearSigmas = 0.7;
  const Maneuver& door = here.maneuver();
  const Point at = here.walker.place.at;
  const double sigma_m = here.walker.sigma_m;
  const bool is_sure = here.walker.is_sure();
  const bool is_at_end = here.at_m >= door.end_m - kBeforeEnd_m;
  if (is_shut(here)) return is_at_end && dot(at - shut_->seen_at, door.out) >= kThrough_m;
  // A closed door that nobody was told of is not behind them because a place that errs says so, nor while they stand.
  if (here.stands || (!is_sure && !told.to_do_next(here))) return here.at_m >= door.end_m + sigma_m;
  // There is no haste: a turn right behind it was told with it, and of two doors the word for the second would be taken
  // for the first. But who hears late of stairs has walked past them.
  if (!is_sure && !here.is_close_to_other_level()) {
    const double clear_m = std::max(kClear_m, kClearSigmas * sigma_m);
    // Who goes straight on behind it gets no further along the path.
    const double beyond_m = dot(at - here.path.place(door.end_m).at, door.out);
    return here.at_m >= door.end_m + clear_m || (is_at_end && beyond_m >= clear_m);
  }
  // Who looks through the door goes through it, and has to know by then where to turn behind it.
  return is_at_end || (here.at_m > door.at_m - 0.1 && here.looks_along(door.out) && here.is_in_front_of(door));
}

}  // namespace fiona::guidance
