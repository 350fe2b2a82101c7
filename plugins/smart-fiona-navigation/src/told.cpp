#include "told.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace fiona::guidance {

using building::Point;
using namespace std::chrono_literals;

void Told::follow(const Situation& here) {
  if (to_do_next(here)) to_do_->least_m = std::min(to_do_->least_m, here.to_spot_m());
}

void Told::note(const Word& word, const Situation& here) {
  const bool is_first = !to_do_next(here) || !last_ || last_->repeated != word.repeated;
  if (word.phase == Phase::Now && is_first) to_do_ = ToDo{word.maneuver, here.now, here.to_spot_m()};
  if (last_ == word) return;
  if (word.phase == Phase::Align) led_back_at_ = here.now;
  since_ = here.now;
  looked_rad_ = here.walker.heading_rad;
  last_ = word;
}

bool Told::has_led_back(TimePoint now) const {
  constexpr auto kComesToPath = 6s;
  return led_back_at_ && now - *led_back_at_ < kComesToPath;
}

bool Told::reacts(const Situation& here) const {
  constexpr auto kReacts = 1500ms;
  return to_do_next(here) && here.now - to_do_->at < kReacts;
}

bool Told::is_doing(const Situation& here) const {
  // A place that is less than sure may tell only later that they are through; and who is takes another word for
  // another door.
  constexpr Duration kSurelyDoes = 9s;
  const bool is_door = here.maneuver().is_door();
  if (!to_do_next(here) || has_missed(here)) return false;
  if (is_door && here.stands && here.now - since_ > kDoes) return false;
  return here.now - to_do_->at < (is_door && !here.walker.is_sure() ? kSurelyDoes : kDoes);
}

bool Told::has_missed(const Situation& here) const {
  constexpr double kAway_m = 1.0;  // further than they have been
  if (here.maneuver().kind == hmi::Instruction::TURN || !to_do_next(here) || reacts(here)) return false;
  const bool gets_away = here.to_spot_m() > to_do_->least_m + kAway_m;
  if (!gets_away || !here.looks_elsewhere(here.maneuver().out)) return false;
  if (!here.looks_elsewhere(here.spot() - here.walker.place.at)) return false;
  // Where one turns to behind it, one may be already.
  return !here.then_rad() || here.looks_elsewhere(here.maneuvers[here.next + 1].out);
}

/// Who has not gone through a door in sight, or walks on beside the path along a wall, has missed the word.
bool Told::is_overdue(const Situation& here) const {
  constexpr Duration kTurnsIn = 2500ms;
  if (was(Phase::Align)) return here.now - since_ > (has_turned(here.walker) ? kDoes : kTurnsIn);
  if (!was(Phase::Now) || is_doing(here)) return false;
  return here.maneuver().is_door() ? here.is_at_door() : has_missed(here);
}

/// Since the newest word: who missed it looks where they looked.
bool Told::has_turned(const Walker& walker) const {
  if (!walker.heading_rad || !looked_rad_) return true;
  return std::abs(std::remainder(*walker.heading_rad - *looked_rad_, 2.0 * std::numbers::pi)) > Situation::kAlong_rad;
}

}  // namespace fiona::guidance
