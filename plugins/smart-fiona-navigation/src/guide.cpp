#include "guide.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <fiona/building/geometry.hpp>

#include "words.hpp"

namespace fiona::guidance {
namespace {

using building::Passage;
using building::Point;
using hmi::Instruction;
using hmi::NextTurn;
using namespace std::chrono_literals;

constexpr double kDegree = std::numbers::pi / 180.0;
/// A walker goes back a little, or takes a short cut, and is still on the path.
constexpr double kBack_m = 4.0;
constexpr double kAhead_m = 10.0;
/// So far from the path is off it; a localisation that is less sure gets twice its standard deviation.
constexpr double kOff_m = 2.5;
constexpr double kMostOff_m = 8.0;
constexpr double kOffLevels = 0.6;
/// A height that a barometer tells is hardly ever a whole level.
constexpr double kOnLevel = 0.3;
constexpr auto kOffFor = 2s;
/// In a lift what is heard is like nothing on any level: on which one it has stopped is known once one has left it.
constexpr auto kOffAtLift = 6s;
constexpr double kAtLift_m = 3.0;
/// So near to where a lift is taken one stands and waits, as in its cabin.
constexpr double kInLift_m = 1.0;
constexpr double kLookAhead_m = 2.5;
constexpr double kHeldUp_m = 0.5;
/// Who is further from a turn or a door has missed it.
constexpr double kBeside_m = 1.2;
/// Beyond it a walker does not walk along the path; and is back on it within the smaller one.
constexpr double kAstray_rad = 50.0 * kDegree;
constexpr double kAlong_rad = 30.0 * kDegree;
/// By less than this nobody is turned whose compass errs as much.
constexpr double kAsTold_rad = 22.5 * kDegree;
/// A place that is less than sure has one look elsewhere for a moment.
constexpr auto kAstrayFor = 1s;
/// But by more than this no corner that the place is taken to be on the wrong side of does.
constexpr double kAway_rad = 120.0 * kDegree;
constexpr auto kThroughDoor = 2s;
/// Who was led back to the path comes to it within so long. Nearer to it than this they are on it.
constexpr auto kComesToPath = 6s;
constexpr double kOnPath_m = 0.3;
constexpr double kThen_m = 3.0;  ///< a turn that is nearer behind a door or stairs is told together with them
constexpr auto kShutFor = 30s;
constexpr double kMostBehind_m = 3.5;
constexpr auto kTurnsBack = 4s;
constexpr double kThrough_m = 1.0;  ///< on, from where it was told of again, and a door is behind
constexpr double kClear_m = 0.5;    ///< of a door
constexpr double kClearSigmas = 0.7;
/// A place that is less sure than this may leap.
constexpr double kSure_m = 0.3;
constexpr double kForward_mps = 1.8;
constexpr double kBackward_mps = 0.8;
constexpr double kUnsureOfSide = 0.5;  ///< of a wall: so many standard deviations
constexpr double kMayBeOnPath = 2.0;   ///< so many of them away from it
/// Who is told to do something needs so long to begin, and so long to do it. A place that is less than sure may tell
/// only later that it is done; and who has gone through a door takes another word for another door.
constexpr auto kReacts = 1500ms;
constexpr auto kDoes = 4s;
constexpr auto kTurnsIn = 2500ms;
constexpr auto kSurelyDoes = 9s;
constexpr auto kLeaves = 10s;        ///< a room, from when it was told
constexpr double kAtDoor_m = 2.5;    ///< a door that is so near, and in sight, is told of wherever one looks
constexpr double kReach_m = 3.0;     ///< off the way to it
constexpr double kBeforeIt_m = 0.5;  ///< who is further aside looks at the wall
constexpr double kAtFoot_m = 0.5;    ///< of stairs
constexpr double kThere_m = 1.5;
constexpr double kMostThere_m = 3.0;
/// Who does not move is told again.
constexpr auto kRepeat = 5s;
constexpr double kMoved_m = 0.7;
/// A place moves by itself by about as much as it is unsure.
constexpr double kMovedSigmas = 0.8;
/// Who does not move for so long neither goes through a door nor is about to.
constexpr auto kStandsFor = 2500ms;
/// Who walks gets on along the path by so much in so long.
constexpr double kGetsOn_m = 2.0;
constexpr auto kGetsOnIn = 8s;
constexpr double kAway_m = 1.0;  ///< further from what was told than one has been: it was missed
constexpr double kStarted_m = 0.8;
constexpr auto kStartedFor = 4s;

bool changes_level(const Maneuver& maneuver) { return maneuver.to_level.has_value(); }

bool is_door(const Maneuver& maneuver) {
  return maneuver.kind == Instruction::DOOR || maneuver.kind == Instruction::ENTER ||
         maneuver.kind == Instruction::LEAVE;
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
      moved_at_(now) {
  if (!leaves || maneuvers_.front().kind != Instruction::DOOR || !begins_in_room()) return;
  leaves_until_ = *leaves + kLeaves;
  next_ = 1;
}

bool Guide::begins_in_room() const {
  const building::RoutePoint& start = path_.route().points.front();
  const auto room = building::room_index_at(plan_.plan, start.at, start.level);
  return room && plan_.plan.rooms[*room].kind == building::RoomKind::Room;
}

Guide::Advice Guide::follow(const Walker& walker, TimePoint now) {
  locate(walker, now);
  note_motion(walker, now);
  Advice advice;
  const bool may_be_wrong = walker.sigma_m >= kSure_m && on_other_level_ && is_at_lift();
  if (may_be_wrong && stands(walker, now)) wrong_since_ = now;
  advice.off_path = wrong_since_ && now - *wrong_since_ >= (may_be_wrong ? kOffAtLift : kOffFor);
  advice.arrived = arrived(walker);
  if (!advice.arrived) pass(walker, now);
  Key key{advice.arrived ? Phase::Arrived : phase_of(walker, now), next_, said_ ? said_->repeated : 0};
  const bool waits = next().kind == Instruction::LIFT && at_m_ > next().at_m - kInLift_m;
  const bool stands =
      said_ == key && now - std::max(moved_at_, new_since_) > kRepeat && key.phase != Phase::Arrived && !waits;
  // Whatever they have been told meanwhile.
  const bool stuck = gets_nowhere(now) && this->stands(walker, now) && !waits;
  if ((stands || stuck) && return_to_door(walker, now)) {
    key = {phase_of(walker, now), next_, 0};
  } else if (said_ == key && is_overdue(key, walker, now)) {
    ++key.repeated;
  } else if (stands && key.repeated > 0 && walker.heading_rad) {
    back_ = {*walker.heading_rad + std::numbers::pi, now};
  } else if (stands) {
    ++key.repeated;
  }
  if (back_ && now - back_->since < kTurnsBack && key.phase != Phase::Arrived) key = {Phase::Back, next_, 0};
  advice.is_new = said_ != key;
  fill(advice, key, walker);
  const bool told_before = told_ && told_->maneuver == key.maneuver && said_ && said_->repeated == key.repeated;
  if (advice.is_new) {
    if (key.phase == Phase::Align) led_back_at_ = now;
    new_since_ = now;
    looked_rad_ = walker.heading_rad;
  }
  if (key.phase == Phase::Now && !told_before) told_ = Told{key.maneuver, now, distance_m(walker.place.at, spot())};
  said_ = key;
  return advice;
}

void Guide::note_motion(const Walker& walker, TimePoint now) {
  if (told_ && told_->maneuver == next_) told_->least_m = std::min(told_->least_m, distance_m(walker.place.at, spot()));
  if (distance_m(walker.place.at, moved_from_) <= std::max(kMoved_m, kMovedSigmas * walker.sigma_m)) return;
  moved_from_ = walker.place.at;
  moved_at_ = now;
}

bool Guide::gets_nowhere(TimePoint now) {
  if (at_m_ > got_to_m_ + kGetsOn_m || at_m_ < got_to_m_ - kGetsOn_m || got_to_at_ == TimePoint{}) {
    got_to_m_ = at_m_;
    got_to_at_ = now;
  }
  return now - got_to_at_ > kGetsOnIn;
}

bool Guide::stands(const Walker& walker, TimePoint now) const {
  return walker.sigma_m >= kSure_m && now - moved_at_ > kStandsFor;
}

/// Where the next thing is to be done.
Point Guide::spot() const { return path_.place(next().at_m).at; }

/// Who was told to go through a door or to take stairs, and gets away from there otherwise than those lead.
bool Guide::has_missed(const Walker& walker, TimePoint now) const {
  if (next().kind == Instruction::TURN || !told_ || told_->maneuver != next_ || now - told_->at < kReacts) return false;
  const auto leads_elsewhere = [&](Point direction) {
    const auto rest = turn_to(direction, walker);
    return rest && std::abs(*rest) > kAstray_rad;
  };
  const bool gets_away = distance_m(walker.place.at, spot()) > told_->least_m + kAway_m;
  if (!gets_away || !leads_elsewhere(next().out) || !leads_elsewhere(spot() - walker.place.at)) return false;
  // Where one turns to behind it, one may be already.
  return !then() || leads_elsewhere(maneuvers_[next_ + 1].out);
}

/// Who does not get on behind a door has not come through it.
bool Guide::return_to_door(const Walker& walker, TimePoint now) {
  for (std::size_t i = next_; i-- > 0 && at_m_ < maneuvers_[i].end_m + kMostBehind_m;) {
    if (maneuvers_[i].kind != Instruction::DOOR || (shut_ && shut_->maneuver == i && now - shut_->since < kShutFor))
      continue;
    next_ = i;
    shut_ = Shut{i, walker.place.at, now};
    passed_at_ = now;
    return true;
  }
  return false;
}

bool Guide::is_at_lift() const {
  return std::any_of(maneuvers_.begin(), maneuvers_.end(), [this](const Maneuver& one) {
    return one.kind == Instruction::LIFT && at_m_ > one.at_m - kAtLift_m && at_m_ < one.end_m + kAtLift_m;
  });
}

/// Who has been carried to the level that stairs or a lift lead to is not on those any more, though they are near.
double Guide::least_m(const Walker& walker) const {
  double least_m = std::max(0.0, at_m_ - kBack_m);
  for (std::size_t i = 0; i < next_; ++i) {
    const auto& to_level = maneuvers_[i].to_level;
    if (to_level && std::abs(walker.place.level - *to_level) < kOnLevel)
      least_m = std::max(least_m, maneuvers_[i].end_m);
  }
  return least_m;
}

void Guide::locate(const Walker& walker, TimePoint now) {
  const auto level = plan_.level_near(walker.place.level, 0.1);
  const Path::Hidden behind_wall = [&](const building::PathPoint& on_path, Passage passage) {
    const double away_m = distance_m(walker.place.at, on_path.at);
    // A wall that is nearer than the place is sure says little of the side that one is on.
    const double unsure_m = kUnsureOfSide * walker.sigma_m;
    const bool in_plan = passage == Passage::Walk || passage == Passage::Lift;
    if (!level || !in_plan || away_m <= std::max(0.3, unsure_m)) return false;
    const Point nearer = walker.place.at + (on_path.at - walker.place.at) * (unsure_m / away_m);
    return plan_.walled(nearer, on_path.at, *level) || plan_.behind_door(nearer, on_path.at, *level);
  };
  Path::Match match = path_.match(walker.place, least_m(walker), at_m_ + kAhead_m, behind_wall);
  if (match.off_m > 1.0 || match.off_levels > kOffLevels || match.hidden) {
    const Path::Match further = path_.match(walker.place, at_m_, path_.end_m(), behind_wall);
    if (further.off_m < 1.0 && further.off_levels < 0.3 && !further.hidden) match = further;
  }
  at_m_ = steadied(match.at_m, walker, now);
  off_m_ = match.off_m;
  on_other_level_ = match.off_levels > kOffLevels;
  const double most_m = std::clamp(2.0 * walker.sigma_m, kOff_m, kMostOff_m);
  const bool wrong = match.off_m > most_m || on_other_level_ || match.hidden;
  if (!wrong) {
    wrong_since_.reset();
  } else if (!wrong_since_) {
    wrong_since_ = now;
  }
}

/// Nobody runs: a place that leaps ahead, or back, may leap again. From one level to another nobody has walked.
double Guide::steadied(double at_m, const Walker& walker, TimePoint now) {
  const auto before = std::exchange(located_, now);
  const Passage passage = path_.passage(at_m);
  const bool walks = passage == Passage::Walk || passage == Passage::Door;
  const bool on_same_level = std::abs(path_.place(at_m).level - path_.place(at_m_).level) < kOnLevel;
  if (walker.sigma_m < kSure_m || !walks || !on_same_level || !before) return at_m;
  const double since_s = to_seconds(now - *before);
  return std::clamp(at_m, at_m_ - kBackward_mps * since_s, at_m_ + kForward_mps * since_s);
}

bool Guide::has_passed(const Maneuver& maneuver, const Walker& walker, TimePoint now) const {
  if (changes_level(maneuver)) {
    return at_m_ >= maneuver.end_m - 0.4 && std::abs(walker.place.level - *maneuver.to_level) < kOnLevel;
  }
  // Who looks through the door goes through it, and has to know by then where to turn behind it.
  const auto rest = turn_to(maneuver.out, walker);
  const bool looks_there = rest && std::abs(*rest) < kAlong_rad;
  if (maneuver.kind == Instruction::TURN) {
    const double before_m = std::max(0.7, 1.2 * walker.sigma_m);
    return at_m_ > maneuver.end_m + 0.5 + 2.0 * walker.sigma_m || (at_m_ > maneuver.at_m - before_m && looks_there);
  }
  if (shut_ && shut_->maneuver == next_)
    return at_m_ >= maneuver.end_m - 0.2 && dot(walker.place.at - shut_->seen_at, maneuver.out) >= kThrough_m;
  // A closed door that nobody was told of is not behind them because a place that errs says so, nor while they stand.
  const bool was_told = told_ && told_->maneuver == next_;
  if (walker.sigma_m >= kSure_m && !was_told) return at_m_ >= maneuver.end_m + walker.sigma_m;
  if (stands(walker, now)) return at_m_ >= maneuver.end_m + walker.sigma_m;
  // There is no haste: a turn right behind it was told with it, and of two doors the word for the second would be taken
  // for the first. But who hears late of stairs has walked past them.
  if (walker.sigma_m >= kSure_m && !is_close_to_other_level()) {
    // Who goes straight on behind it gets no further along the path.
    const double beyond_m = dot(walker.place.at - path_.place(maneuver.end_m).at, maneuver.out);
    const double clear_m = std::max(kClear_m, kClearSigmas * walker.sigma_m);
    return at_m_ >= maneuver.end_m + clear_m || (at_m_ >= maneuver.end_m - 0.2 && beyond_m >= clear_m);
  }
  return at_m_ >= maneuver.end_m - 0.2 || (at_m_ > maneuver.at_m - 0.1 && looks_there && is_before(maneuver, walker));
}

/// Right behind the next maneuver there are stairs or a lift.
bool Guide::is_close_to_other_level() const {
  if (next_ + 1 == maneuvers_.size()) return false;
  const Maneuver& behind = maneuvers_[next_ + 1];
  return changes_level(behind) && behind.at_m - next().end_m < kNow_m;
}

bool Guide::is_before(const Maneuver& door, const Walker& walker) const {
  return std::abs(cross(walker.place.at - path_.place(door.at_m).at, door.out)) < kBeforeIt_m;
}

bool Guide::is_at_door(const Walker& walker) const {
  const building::PathPoint door = path_.place(next().at_m);
  return distance_m(walker.place.at, door.at) < kAtDoor_m && !plan_.walled(walker.place.at, door.at, door.level);
}

/// Who has not gone through a door in sight, or walks on beside the path along a wall, has missed the word.
bool Guide::is_overdue(const Key& key, const Walker& walker, TimePoint now) const {
  if (key.phase == Phase::Align) return now - new_since_ > (turns(walker) ? Duration(kDoes) : Duration(kTurnsIn));
  if (key.phase != Phase::Now || is_doing(walker, now)) return false;
  return is_door(next()) ? is_at_door(walker) : has_missed(walker, now);
}

/// Since the newest word: who missed it looks where they looked.
bool Guide::turns(const Walker& walker) const {
  if (!walker.heading_rad || !looked_rad_) return true;
  return std::abs(std::remainder(*walker.heading_rad - *looked_rad_, 2.0 * std::numbers::pi)) > kAlong_rad;
}

/// What was told last.
bool Guide::is_doing(const Walker& walker, TimePoint now) const {
  if (has_missed(walker, now)) return false;
  const Duration does = walker.sigma_m < kSure_m || !is_door(next()) ? Duration(kDoes) : Duration(kSurelyDoes);
  if (is_door(next()) && stands(walker, now) && now - new_since_ > kDoes) return false;
  return told_ && told_->maneuver == next_ && now - told_->at < does;
}

void Guide::pass(const Walker& walker, TimePoint now) {
  const std::size_t before = next_;
  const double unsure_m = std::min(walker.sigma_m, 2.0);
  const bool leaves = next_ == 1 && leaves_until_ && now < *leaves_until_;
  while (next_ > 0 && !leaves && at_m_ < maneuvers_[next_ - 1].at_m - kNow_m - unsure_m) --next_;
  // Who seemed to go through a door and still stands before it is told of the door again; who has gone on beside it, at
  // once: what is behind it lies behind a wall.
  const auto missed_it = [&](const Maneuver& door) {
    return now - passed_at_ > kThroughDoor || (walker.sigma_m < kSure_m && is_door(door) && !is_before(door, walker));
  };
  if (next_ > 0 && !leaves && at_m_ < maneuvers_[next_ - 1].end_m - 0.2 - unsure_m && missed_it(maneuvers_[next_ - 1]))
    shut_ = Shut{--next_, walker.place.at, now};
  const auto reacts = [&] { return told_ && told_->maneuver == next_ && now - told_->at < kReacts; };
  while (next_ + 1 < maneuvers_.size() && !reacts() && has_passed(next(), walker, now)) ++next_;
  if (next_ != before) passed_at_ = now;
}

bool Guide::arrived(const Walker& walker) const {
  const auto end = path_.place(path_.end_m());
  const double there_m = std::clamp(walker.sigma_m, kThere_m, kMostThere_m);
  // Nobody has arrived who may be elsewhere.
  if (walker.sigma_m > kMostThere_m) return false;
  return distance_m(walker.place.at, end.at) <= there_m && std::abs(walker.place.level - end.level) < 0.3 &&
         !plan_.walled(walker.place.at, end.at, end.level);
}

/// The way to turn, clockwise; nothing if it is not known where the walker looks.
std::optional<double> Guide::turn_to(Point direction, const Walker& walker) const {
  if (!walker.heading_rad || direction == Point{}) return std::nullopt;
  const double bearing = std::atan2(direction.x_m, direction.y_m) + plan_.heading_rad;
  return std::remainder(bearing - *walker.heading_rad, 2.0 * std::numbers::pi);
}

/// The direction to walk in now: to a place of the path a little ahead that is in sight, at most to the next maneuver,
/// and at that one the direction in which it leads.
Point Guide::aim(const Walker& walker) const {
  const bool is_there = to_next_m() < 1.0 && next().kind != Instruction::ARRIVE;
  // Who stands beside the path has a corner of a wall before them: back to the path first.
  const bool held_up = located_ && off_m_ > kHeldUp_m && stands(walker, *located_);
  const double look_ahead_m = held_up ? kHeldUp_m : kLookAhead_m;
  const double far_m =
      is_there ? std::min(next().end_m + look_ahead_m, path_.end_m()) : std::min(at_m_ + look_ahead_m, next().at_m);
  // Where a flight ends says nothing of where it begins.
  const bool at_stairs = is_there && changes_level(next()) && next().out != Point{};
  if (at_stairs && off_m_ > std::max(kBeside_m, walker.sigma_m)) return building::unit(spot() - walker.place.at);
  if (at_stairs) return at_m_ < next().at_m + kAtFoot_m ? next().out : path_.direction(at_m_);
  const bool before_shut = shut_ && shut_->maneuver == next_ && at_m_ > next().at_m - 0.5;
  if (before_shut && next().out != Point{}) return next().out;
  const auto level = plan_.level_near(walker.place.level, 0.1);
  // A door that was missed is behind.
  const bool missed = is_door(next()) && located_ && has_missed(walker, *located_);
  if (missed && !(level && plan_.walled(walker.place.at, spot(), *level)))
    return building::unit(spot() - walker.place.at);
  // Who may as well be on the path is taken to be there, unless a wall is in the way beside it.
  const Point on_path = path_.place(at_m_).at;
  const Point ahead = path_.place(far_m).at - on_path;
  const bool as_if_on_path = !held_up && off_m_ < kMayBeOnPath * walker.sigma_m &&
                             !(level && plan_.walled(walker.place.at, walker.place.at + ahead, *level));
  const Point from = as_if_on_path ? on_path : walker.place.at;
  for (const double at : {far_m, (at_m_ + far_m) / 2.0, at_m_}) {
    const Point to = path_.place(at).at;
    if (distance_m(from, to) < 0.3) continue;
    if (level && plan_.walled(from, to, *level)) continue;
    return building::unit(to - from);
  }
  return is_there && next().out != Point{} ? next().out : path_.direction(at_m_);
}

Guide::Phase Guide::phase_of(const Walker& walker, TimePoint now) {
  const bool leaves = leaves_until_ && now < *leaves_until_;
  const bool starts = first_ && !leaves_until_ && (!said_ || said_->phase == Phase::Start);
  if (starts && at_m_ < kStarted_m && now - begun_ < kStartedFor) return Phase::Start;
  const bool in_it = at_m_ > next().at_m - 0.3;
  const double ahead_m = to_next_m();
  if (changes_level(next()) && in_it) return Phase::Now;
  // A door that is further than it is told to be is not gone through now.
  const bool out_of_reach = is_door(next()) && distance_m(walker.place.at, spot()) > ahead_m + kReach_m;
  if (out_of_reach && off_m_ > kBeside_m && !leaves) return Phase::Align;
  // Who was told to go through a door is about to: another word would be taken for another door.
  if (is_doing(walker, now) && next().kind != Instruction::TURN) return Phase::Now;
  if (nearest_ == std::pair{next_, Phase::Now} && is_door(next()) && is_at_door(walker)) return Phase::Now;
  const auto rest = turn_to(aim(walker), walker);
  if (!rest || std::abs(*rest) < kAlong_rad) aligned_ = true;
  if (!rest || std::abs(*rest) <= kAstray_rad) {
    astray_since_.reset();
  } else {
    if (!astray_since_) astray_since_ = now;
    const bool is_sure = walker.sigma_m < kSure_m || std::abs(*rest) > kAway_rad;
    if (is_sure || now - *astray_since_ >= kAstrayFor) aligned_ = false;
  }
  const bool is_there =
      ahead_m < 1.0 && off_m_ < std::max(kBeside_m, walker.sigma_m) && next().kind != Instruction::ARRIVE;
  if (rest && !leaves && joins(walker, *rest, now)) return Phase::Join;
  if (!aligned_ && !is_there && !leaves) return Phase::Align;
  if (next().kind == Instruction::ARRIVE) return Phase::Ahead;
  return nearness(walker);
}

/// Who was led back to the path, and comes to it across, is told in time to turn along it; at the path they would walk
/// past it.
bool Guide::joins(const Walker& walker, double rest_rad, TimePoint now) const {
  if (off_m_ >= kNow_m || to_next_m() <= 1.0 || path_.passage(at_m_) != Passage::Walk) return false;
  const auto along = turn_to(path_.direction(at_m_), walker);
  if (!along || std::abs(*along) <= kAstray_rad || std::abs(*along) >= kAway_rad) return false;
  if (said_ && said_->phase == Phase::Join && now - new_since_ < kDoes) return true;
  return led_back_at_ && now - *led_back_at_ < kComesToPath && std::abs(rest_rad) < kAlong_rad && off_m_ > kOnPath_m;
}

/// What has been announced, or said to be now, stays so: said again it would be taken for another one.
Guide::Phase Guide::nearness(const Walker& walker) {
  if (nearest_.first != next_) nearest_ = {next_, Phase::Ahead};
  Phase& nearest = nearest_.second;
  const double ahead_m = to_next_m();
  const double back_m = 1.0 + 2.0 * walker.sigma_m;
  // So near there is no time for two sentences.
  const bool late = nearest == Phase::Ahead && ahead_m <= kNow_m + 1.0;
  if (ahead_m <= kNow_m || late) {
    nearest = Phase::Now;
  } else if (ahead_m <= kAnnounced_m && (nearest != Phase::Now || ahead_m > kNow_m + back_m)) {
    nearest = Phase::Announced;
  } else if (ahead_m > kAnnounced_m + back_m) {
    nearest = Phase::Ahead;
  }
  return nearest;
}

NextTurn::TypeOfTurn Guide::hour(Phase phase, const Walker& walker) const {
  if (phase == Phase::Arrived) return NextTurn::TYPE_OF_TURN_UNSPECIFIED;
  if (phase == Phase::Back)
    return hour_of(
        std::remainder(back_->heading_rad - walker.heading_rad.value_or(back_->heading_rad), 2.0 * std::numbers::pi));
  if (phase == Phase::Join) return hour_of(turn_to(path_.direction(at_m_), walker).value_or(0.0));
  const bool at_turn = (phase == Phase::Now && to_next_m() >= 1.0) || phase == Phase::Announced;
  const Point to = at_turn ? next().out : aim(walker);
  if (to == Point{}) return NextTurn::TYPE_OF_TURN_UNSPECIFIED;
  if (phase == Phase::Ahead && leaves_until_ && located_ && *located_ < *leaves_until_) return NextTurn::HOUR_12;
  const Point along = path_.direction(std::max(0.0, at_turn || is_before_turn(phase) ? next().at_m - 0.1 : at_m_));
  const auto as_on_path = [&](Point way) { return hour_of(-std::atan2(cross(along, way), dot(along, way))); };
  if ((at_turn || is_before_turn(phase)) && walks_along(along, walker)) return as_on_path(next().out);
  if (const auto rest = turn_to(to, walker))
    return is_as_told(phase, *rest, walker) ? NextTurn::HOUR_12 : hour_of(*rest);
  // Not known where the walker looks: along the path.
  return along == Point{} ? NextTurn::TYPE_OF_TURN_UNSPECIFIED : as_on_path(to);
}

bool Guide::is_before_turn(Phase phase) const { return phase == Phase::Now && next().kind == Instruction::TURN; }

/// Walls lead better than a compass among them: who walks about along the way is taken to walk along it, and turns by
/// as much as it does.
bool Guide::walks_along(Point along, const Walker& walker) const {
  const auto rest = turn_to(along, walker);
  return walker.sigma_m >= kSure_m && rest && std::abs(*rest) < kAlong_rad && next().out != Point{};
}

/// Who walks about where they were told to is not corrected by what a compass may err, for one hears whole hours.
bool Guide::is_as_told(Phase phase, double rest_rad, const Walker& walker) const {
  const bool turns = phase == Phase::Now && next().kind == Instruction::TURN && told_ && told_->maneuver == next_;
  return walker.sigma_m >= kSure_m && (phase == Phase::Ahead || turns) && std::abs(rest_rad) < kAsTold_rad;
}

/// The turn right behind the next maneuver, or to the door there, clockwise from how one arrives.
std::optional<double> Guide::then() const {
  const bool on_foot = next().kind == Instruction::DOOR || next().kind == Instruction::ENTER ||
                       next().kind == Instruction::LEAVE || next().kind == Instruction::STAIRS;
  if (!on_foot || next_ + 1 == maneuvers_.size()) return std::nullopt;
  const Maneuver& behind = maneuvers_[next_ + 1];
  const Point along = path_.direction(next().end_m - 0.01);
  const double turn_rad = -std::atan2(cross(along, behind.out), dot(along, behind.out));
  const bool turns = behind.kind == Instruction::TURN || (is_door(behind) && std::abs(turn_rad) > kAstray_rad);
  return turns && behind.at_m - next().end_m <= kThen_m ? std::optional(turn_rad) : std::nullopt;
}

void Guide::fill(Advice& advice, const Key& key, const Walker& walker) {
  Instruction& made = advice.instruction;
  const bool turns = key.phase == Phase::Align || key.phase == Phase::Join || key.phase == Phase::Back;
  const bool now = key.phase == Phase::Start || turns || key.phase == Phase::Arrived;
  made.set_kind(key.phase == Phase::Arrived ? Instruction::ARRIVE
                : key.phase == Phase::Start ? Instruction::START
                : turns                     ? Instruction::TURN
                : key.phase == Phase::Ahead ? Instruction::CONTINUE
                                            : next().kind);
  made.set_distance(key.phase == Phase::Join ? off_m_ : now ? 0.0 : to_next_m());
  made.set_hour(hour(key.phase, walker));
  made.set_level(path_.place(now ? at_m_ : next().at_m).level);
  if ((key.phase == Phase::Now || key.phase == Phase::Announced) && next().to_level)
    made.set_to_level(*next().to_level);
  if (key.phase == Phase::Now || key.phase == Phase::Announced) {
    if (const auto turn = then()) made.set_then_hour(hour_of(*turn));
  }
  if (advice.is_new) words_ = words(key, made, walker);
  // Who has begun to walk before there was a way hears of it with the first word.
  if (!said_ && leaves_until_) words_ = "To " + destination_ + ", " + metres(path_.route().length_m) + ". " + words_;
  made.set_text(words_);
  made.set_language("en");
  if (key.phase == Phase::Start || turns) {
    advice.turn.set_distance_to_turn(static_cast<std::uint32_t>(std::lround(1000.0 * made.distance())));
    advice.turn.set_type_of_turn(made.hour());
  } else if (key.phase != Phase::Arrived && next().out != Point{}) {
    advice.turn.set_distance_to_turn(static_cast<std::uint32_t>(std::lround(1000.0 * to_next_m())));
    advice.turn.set_type_of_turn(hour(key.phase == Phase::Ahead ? Phase::Announced : key.phase, walker));
  }
}

std::string Guide::words(const Key& key, const Instruction& instruction, const Walker& walker) const {
  switch (key.phase) {
    case Phase::Arrived: return "You have arrived: " + destination_ + ".";
    case Phase::Start:
      return "To " + destination_ + ", " + metres(path_.route().length_m) + ": " +
             (instruction.hour() == NextTurn::HOUR_6    ? "turn around"
              : instruction.hour() == NextTurn::HOUR_12 ? "go straight on"
                                                        : "turn " + direction_words(instruction.hour())) +
             ".";
    case Phase::Back: return "You do not get on there. Turn around, and walk some steps.";
    case Phase::Align:
      return instruction.hour() == NextTurn::HOUR_6 ? "Turn around."
             : instruction.hour() == NextTurn::HOUR_12
                 ? "Go straight on to the path."
                 : "Turn " + direction_words(instruction.hour()) + " to the path.";
    case Phase::Join: return "Turn " + direction_words(instruction.hour()) + " now.";
    case Phase::Ahead:
      return next().kind == Instruction::ARRIVE ? "Go on for " + metres(to_next_m()) + " to " + destination_ + "."
                                                : "Go straight on for " + metres(to_next_m()) + ".";
    default: break;
  }
  const bool now = key.phase == Phase::Now;
  return maneuver_words(plan_.plan, next(), instruction.hour(), path_.place(next().at_m).level,
                        now ? std::nullopt : std::optional(to_next_m()), instruction.then_hour());
}

}  // namespace fiona::guidance
