#include "path_tracker.hpp"

#include <algorithm>
#include <cmath>

#include <fiona/building/geometry.hpp>

namespace fiona::guidance {

using building::Passage;
using building::Point;
using namespace std::chrono_literals;

namespace {

constexpr double kOffLevels = 0.6;
constexpr double kOnLevel = 0.3;  // a height that a barometer tells is hardly ever a whole level

/// Of a wall that is further away than so many standard deviations it is known on which side somebody is.
constexpr double kSureOfSide = 2.0;

bool is_at_lift(const Situation& here) {
  constexpr double kAtLift_m = 3.0;
  return std::any_of(here.maneuvers.begin(), here.maneuvers.end(), [&](const Maneuver& one) {
    return one.kind == hmi::Instruction::LIFT && here.at_m > one.at_m - kAtLift_m && here.at_m < one.end_m + kAtLift_m;
  });
}

}  // namespace

void PathTracker::locate(Situation& here) {
  const Path::Match found = match(here);
  at_m_ = steadied(found.at_m, here);
  located_ = here.now;
  here.at_m = at_m_;
  here.off_m = found.off_m;
  note_motion(here);
  note_progress(here);
  note_whether_off(here, found);
}

/// The nearest place of the path that is in sight.
Path::Match PathTracker::match(const Situation& here) const {
  constexpr double kAhead_m = 10.0;      // who takes a short cut is still on the path
  constexpr double kUnsureOfSide = 0.5;  // of a wall: so many standard deviations
  const building::PathPoint& place = here.walker.place;
  const Path::Hidden behind_wall = [&](const building::PathPoint& on_path, Passage passage) {
    const bool in_plan = passage == Passage::Walk || passage == Passage::Lift;
    return in_plan && is_hidden(here, on_path.at, kUnsureOfSide);
  };
  const Path::Match near = here.path.match(place, least_m(here), at_m_ + kAhead_m, behind_wall);
  if (near.off_m <= 1.0 && near.off_levels <= kOffLevels && !near.hidden) return near;
  const Path::Match further = here.path.match(place, at_m_, here.path.end_m(), behind_wall);
  return further.off_m < 1.0 && further.off_levels < 0.3 && !further.hidden ? further : near;
}

/// A wall that is nearer than so many standard deviations of the place says little of the side that one is on.
bool PathTracker::is_hidden(const Situation& here, Point on_path, double sigmas) {
  constexpr double kLeast_m = 0.3;
  const Point at = here.walker.place.at;
  const auto level = here.plan.level_near(here.walker.place.level, 0.1);
  const double away_m = distance_m(at, on_path);
  const double unsure_m = sigmas * here.walker.sigma_m;
  if (!level || away_m <= std::max(kLeast_m, unsure_m)) return false;
  const Point nearer = at + (on_path - at) * (unsure_m / away_m);
  return here.plan.walled(nearer, on_path, *level) || here.plan.behind_door(nearer, on_path, *level);
}

/// Who has been carried to the level that stairs or a lift lead to is not on those any more, though they are near.
double PathTracker::least_m(const Situation& here) const {
  constexpr double kBack_m = 4.0;  // who goes back a little is still on the path
  double least_m = std::max(0.0, at_m_ - kBack_m);
  for (std::size_t i = 0; i < here.next; ++i) {
    const auto& to_level = here.maneuvers[i].to_level;
    if (to_level && std::abs(here.walker.place.level - *to_level) < kOnLevel)
      least_m = std::max(least_m, here.maneuvers[i].end_m);
  }
  return least_m;
}

/// Nobody runs: a place that leaps ahead, or back, may leap again. From one level to another nobody has walked. But who
/// is surely before a wall has not come through it.
double PathTracker::steadied(double at_m, const Situation& here) const {
  constexpr double kForward_mps = 1.8;
  constexpr double kBackward_mps = 0.8;
  const Passage passage = here.path.passage(at_m);
  const bool walks = passage == Passage::Walk || passage == Passage::Door;
  const bool on_same_level = std::abs(here.path.place(at_m).level - here.path.place(at_m_).level) < kOnLevel;
  if (here.walker.is_sure() || !walks || !on_same_level || !located_) return at_m;
  const double since_s = to_seconds(here.now - *located_);
  const double steady_m = std::clamp(at_m, at_m_ - kBackward_mps * since_s, at_m_ + kForward_mps * since_s);
  const bool is_before_wall = at_m < steady_m && is_hidden(here, here.path.place(steady_m).at, kSureOfSide);
  return is_before_wall ? at_m : steady_m;
}

/// A place moves by itself by about as much as it is unsure.
void PathTracker::note_motion(Situation& here) {
  constexpr double kMoved_m = 0.7;
  constexpr double kMovedSigmas = 0.8;
  constexpr auto kStandsFor = 2500ms;
  const double still_m = std::max(kMoved_m, kMovedSigmas * here.walker.sigma_m);
  const bool is_still = distance_m(here.walker.place.at, moved_.to) <= still_m;
  if (!is_still) moved_ = {here.walker.place.at, here.now};
  here.moved_at = moved_.at;
  here.stands = !here.walker.is_sure() && here.now - moved_.at > kStandsFor;
}

/// Who walks gets on by so much in so long.
void PathTracker::note_progress(Situation& here) {
  constexpr double kGetsOn_m = 2.0;
  constexpr auto kGetsOnIn = 8s;
  const bool gets_on = at_m_ > got_to_.at_m + kGetsOn_m || at_m_ < got_to_.at_m - kGetsOn_m;
  if (gets_on || got_to_.since == TimePoint{}) got_to_ = {at_m_, here.now};
  here.gets_nowhere = here.now - got_to_.since > kGetsOnIn;
}

void PathTracker::note_whether_off(Situation& here, const Path::Match& match) {
  constexpr double kOff_m = 2.5;
  constexpr double kOffSigmas = 2.0;
  constexpr double kMostOff_m = 8.0;
  constexpr Duration kOffFor = 2s;
  constexpr Duration kOffAtLift = 6s;
  const bool on_other_level = match.off_levels > kOffLevels;
  const double most_m = std::clamp(kOffSigmas * here.walker.sigma_m, kOff_m, kMostOff_m);
  // In a lift what is heard is like nothing on any level: on which one it has stopped is known once one has left it.
  const bool may_be_in_lift = on_other_level && !here.walker.is_sure() && is_at_lift(here);
  if (match.off_m <= most_m && !on_other_level && !match.hidden) {
    off_since_.reset();
  } else if (!off_since_ || (may_be_in_lift && here.stands)) {
    off_since_ = here.now;
  }
  // Nobody is led on along a path that is surely behind a wall, not for a moment.
  const bool surely_hidden =
      match.hidden && !on_other_level && is_hidden(here, here.path.place(match.at_m).at, kSureOfSide);
  const Duration off_for = surely_hidden ? 0s : may_be_in_lift ? kOffAtLift : kOffFor;
  here.is_off = off_since_ && here.now - *off_since_ >= off_for;
}

}  // namespace fiona::guidance
