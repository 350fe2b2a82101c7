#include "fiona/simulator/guided_walker.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <fiona/error.hpp>

namespace fiona::simulator {
namespace {

using building::Connector;
using building::ConnectorKind;
using building::PathPoint;
using building::Point;
using building::Segment;
using hmi::Instruction;

constexpr double kStep_s = 0.005;
constexpr double kHour_rad = std::numbers::pi / 6.0;
constexpr double kBody_m = 0.25;    ///< half a person's width
constexpr double kHere_m = 2.3;     ///< what is so near is done now
constexpr double kSight_m = 6.0;    ///< doorways, stairs and lifts that one recognises
constexpr double kOpen_m = 1.8;     ///< a way that is free for so far can be turned into
constexpr double kTooLate_m = 4.0;  ///< beyond the place of a turn one does not look for it any more
constexpr double kBlockedFor_s = 3.0;
constexpr double kVeerTime_s = 3.0;
constexpr double kBeforeDoor_m = 0.6;
constexpr double kSidestep_m = 0.3;
constexpr double kDoors_s = 3.0;  ///< to close, and to open
/// Behind a door, and while one is about to turn, one walks slowly.
constexpr milliseconds kCareful{1000};
constexpr double kCarefulShare = 0.6;
/// A direction that one was told is corrected by the walls so far; and while one only walks on.
constexpr double kNarrow_rad = 0.35;
constexpr double kWide_rad = 0.6;
constexpr double kSlides_rad = 0.2;      ///< between where one looks and where one gets on: a wall is in the way
constexpr double kSidewards_rad = 1.35;  ///< a doorway is looked for so far to either side of the direction told

double turn_between(double to_rad, double from_rad) {
  return std::remainder(to_rad - from_rad, 2.0 * std::numbers::pi);
}

double around(double angle_rad) {
  const double turned = std::fmod(angle_rad, 2.0 * std::numbers::pi);
  return turned < 0.0 ? turned + 2.0 * std::numbers::pi : turned;
}

/// Whether it is to be done now, and more than to go on.
bool is_done_here(const Instruction& said) {
  return said.has_distance() && said.distance() <= kHere_m && said.kind() != Instruction::CONTINUE &&
         said.kind() != Instruction::START && said.kind() != Instruction::ARRIVE;
}

bool is_door(Instruction::Kind kind) {
  return kind == Instruction::DOOR || kind == Instruction::ENTER || kind == Instruction::LEAVE;
}

/// To turn by afterwards.
std::optional<double> then(const Instruction& said) {
  if (said.then_hour() == hmi::NextTurn::TYPE_OF_TURN_UNSPECIFIED) return std::nullopt;
  return static_cast<int>(said.then_hour()) * kHour_rad;
}

/// What is nearest to a place and ahead.
struct Best {
  double score = 1e9;
  bool takes(double other) { return other < score ? (score = other, true) : false; }
};

}  // namespace

GuidedWalker::GuidedWalker(const building::Building& building, std::uint64_t seed, Options options)
    : building_(building), options_(std::move(options)), random_(seed, hash("guided-walker")) {
  set_barriers();
  const building::Room* room = nullptr;
  if (!options_.start_room.empty()) {
    room = &building.room(options_.start_room);
  } else {
    std::vector<const building::Room*> rooms;
    for (const building::Room& one : building.rooms()) {
      if (one.kind == building::RoomKind::Room && one.access == building::kOpen) rooms.push_back(&one);
    }
    if (rooms.empty()) {
      throw Error(ErrorCode::NotFound, {.what = "nobody can be led in " + building.name() + ": it has no open room",
                                        .where = building.name(),
                                        .expected = "closed ways with indoor=room and a level",
                                        .next = "draw rooms, or name the room to start in"});
    }
    room = rooms[random_.below(rooms.size())];
  }
  truth_.x_m = room->centre.x_m;
  truth_.y_m = room->centre.y_m;
  truth_.level = room->level;
  truth_.height_m = building.height_m(room->level);
  wish_rad_ = truth_.heading_rad = random_.uniform(0.0, 2.0 * std::numbers::pi);
}

void GuidedWalker::hear(const Instruction& instruction) {
  if (instruction.kind() == Instruction::ATTENTION) return;
  if (instruction.number() != reacting_to_) {
    reacting_to_ = instruction.number();
    reaction_s_ = random_.uniform(options_.shortest_reaction_s, options_.longest_reaction_s);
    turn_error_rad_ = options_.turn_error_rad * random_.normal();
  }
  Heard heard{truth_.t + milliseconds(std::llround(1000.0 * reaction_s_)), truth_.heading_rad, walked_m_, instruction};
  if (instruction.hour() != hmi::NextTurn::TYPE_OF_TURN_UNSPECIFIED) {
    heard.direction_rad = around(truth_.heading_rad + (instruction.hour() % 12) * kHour_rad);
  }
  constexpr std::size_t kMostHeard = 64;
  if (heard_.size() == kMostHeard) heard_.pop_front();
  heard_.push_back(std::move(heard));
}

bool GuidedWalker::notices(std::uint32_t number) {
  if (missed_.contains(number)) return false;
  if (last_ && last_->said.number() == number && last_->said.distance() <= kHere_m) return true;
  if (random_.uniform() >= options_.missed_share) return true;
  missed_.insert(number);
  return false;
}

void GuidedWalker::act(const Heard& heard) {
  const Instruction& said = heard.said;
  const bool here = said.has_distance() && said.distance() <= kHere_m;
  switch (said.kind()) {
    case Instruction::START:
    case Instruction::CONTINUE:
      walking_ = true;
      turn_.reset();
      careful_until_ = truth_.t;
      if (said.kind() == Instruction::START && said.hour() == hmi::NextTurn::TYPE_OF_TURN_UNSPECIFIED) leave_room();
      // Straight on is where one walks already.
      if (said.hour() != hmi::NextTurn::HOUR_12 && said.hour() != hmi::NextTurn::TYPE_OF_TURN_UNSPECIFIED) {
        wish_rad_ = along_walls(heard.direction_rad + 0.5 * turn_error_rad_, kNarrow_rad);
      }
      break;
    case Instruction::TURN:
    case Instruction::DOOR:
    case Instruction::ENTER:
    case Instruction::LEAVE:
    case Instruction::STAIRS:
    case Instruction::ESCALATOR:
    case Instruction::RAMP:
    case Instruction::LIFT:
      walking_ = true;
      if (here && notices(said.number())) act_here(heard);
      if (!here) wish_rad_ = along_walls(wish_rad_, kWide_rad);
      break;
    default:
      walking_ = false;
      turn_.reset();
      break;
  }
  last_ = heard;
}

void GuidedWalker::act_here(const Heard& heard) {
  const Instruction& said = heard.said;
  if (done_.contains(said.number())) return;
  bool found = false;
  switch (said.kind()) {
    case Instruction::TURN: return turn_at(heard);
    case Instruction::LIFT: found = enter_lift(said.to_level()); break;
    case Instruction::DOOR:
    case Instruction::ENTER:
    case Instruction::LEAVE: found = go_through_door(heard); break;
    default: found = climb(said); break;
  }
  if (found) {
    done_.insert(said.number());
    turn_.reset();
    errand_->then_rad = then(said);
  } else if (said.hour() != hmi::NextTurn::TYPE_OF_TURN_UNSPECIFIED && said.distance() < 0.5) {
    wish_rad_ = along_walls(heard.direction_rad, kNarrow_rad);
  }
}

void GuidedWalker::turn_at(const Heard& heard) {
  turn_ = Turn{along_walls(heard.direction_rad + turn_error_rad_, kNarrow_rad),
               heard.walked_m + heard.said.distance() - 0.4};
}

/// The doorway nearest to where it was told to be, that leads about where it was told to lead.
bool GuidedWalker::go_through_door(const Heard& heard) {
  const double left_m = std::max(0.0, heard.walked_m + heard.said.distance() - walked_m_);
  const Point told = at() + direction(truth_.heading_rad) * left_m;
  Best best;
  Errand errand;
  double wish_rad = 0.0;
  for (const building::Door& door : building_.doors()) {
    const Point way = door.at - at();
    if (door.level != truth_.level || length_m(way) > kSight_m || door.access > options_.access) continue;
    const Point through = door.normal * (dot(way, door.normal) < 0.0 ? -1.0 : 1.0);
    const double aside = std::abs(turn_between(heading(through), heard.direction_rad));
    // Who is nearer does not step back first, nor turn to a doorway that is in front of them.
    const double before_m = std::clamp(dot(way, through), kBody_m, kBeforeDoor_m);
    const Point before = door.at - through * before_m;
    if (aside > kSidewards_rad || !sees(at(), before) || !best.takes(distance_m(told, door.at) + 2.0 * aside)) continue;
    errand.points = {{door.at + through * kBeforeDoor_m, door.level}};
    if (distance_m(before, at()) > kSidestep_m) errand.points.push_front({before, door.level});
    errand.door = true;
    wish_rad = heading(through);
  }
  if (errand.points.empty()) return false;
  wish_rad_ = wish_rad;
  errand_ = std::move(errand);
  return true;
}

/// Through the nearest doorway: where it leads, one was not told.
void GuidedWalker::leave_room() {
  Best best;
  for (const building::Door& door : building_.doors()) {
    const Point way = door.at - at();
    if (door.level != truth_.level || length_m(way) > kSight_m || door.access > options_.access) continue;
    const Point through = door.normal * (dot(way, door.normal) < 0.0 ? -1.0 : 1.0);
    const Point before = door.at - through * kBeforeDoor_m;
    if (!sees(at(), before) || !best.takes(length_m(way))) continue;
    errand_ = Errand{.points = {{before, door.level}, {door.at + through * kBeforeDoor_m, door.level}}, .door = true};
    wish_rad_ = heading(through);
  }
}

bool GuidedWalker::climb(const Instruction& said) {
  const double to_level = said.to_level();
  Best best;
  Errand errand;
  for (const Connector& connector : building_.connectors()) {
    if (connector.kind == ConnectorKind::Lift) continue;
    std::vector<PathPoint> path = connector.path;
    for (const bool turned : {false, true}) {
      if (turned) std::reverse(path.begin(), path.end());
      if ((turned && connector.one_way) || path.front().level != truth_.level) continue;
      const bool leads = std::abs(path.back().level - to_level) < std::abs(truth_.level - to_level);
      const double way_m = distance_m(path.front().at, at());
      if (!leads || way_m > kSight_m || !sees(at(), path.front().at) || !best.takes(way_m)) continue;
      errand.points.assign(path.begin(), path.end());
    }
  }
  if (errand.points.empty()) return false;
  errand.stairs = true;
  const std::size_t last = errand.points.size() - 1;
  wish_rad_ = heading(errand.points[last].at - errand.points[last - 1].at);
  errand_ = std::move(errand);
  return true;
}

bool GuidedWalker::enter_lift(double to_level) {
  for (const Connector& connector : building_.connectors()) {
    if (connector.kind != ConnectorKind::Lift) continue;
    const bool stops = std::any_of(connector.path.begin(), connector.path.end(),
                                   [&](const PathPoint& stop) { return stop.level == to_level; });
    for (const PathPoint& stop : connector.path) {
      if (stop.level != truth_.level || !stops || distance_m(stop.at, at()) > kSight_m || !sees(at(), stop.at))
        continue;
      errand_ = Errand{{stop}, to_level, kDoors_s + building::kLiftWait_s / 2.0};
      wish_rad_ = truth_.heading_rad + std::numbers::pi;  // one leaves by the door that one came in by
      return true;
    }
  }
  return false;
}

void GuidedWalker::advance(milliseconds to) {
  while (truth_.t + Pedestrian::kTick <= to) step();
}

void GuidedWalker::step() {
  truth_.t += Pedestrian::kTick;
  const Point before = at();
  const double height_m = truth_.height_m;
  if (errand_) {
    run(*errand_);
  } else {
    while (!heard_.empty() && heard_.front().due <= truth_.t && !errand_) {
      const Heard heard = std::move(heard_.front());
      heard_.pop_front();
      act(heard);
    }
    if (!errand_) walk();
  }
  note_motion(before, height_m);
}

/// What was heard meanwhile was said on the way: the newest holds. What is said of a door to one who is going through
/// one is said of that.
void GuidedWalker::take_in(Errand& errand) {
  for (const Heard& heard : heard_) {
    const bool of_this = errand.door ? is_door(heard.said.kind()) : last_ && heard.said.kind() == last_->said.kind();
    if (!of_this || !done_.insert(heard.said.number()).second) continue;
    if (const auto turn = then(heard.said)) errand.then_rad = turn;
  }
  if (heard_.size() > 1) heard_.erase(heard_.begin(), heard_.end() - 1);
}

void GuidedWalker::run(Errand& errand) {
  take_in(errand);
  if (errand.points.empty()) {
    if (errand.ride_to) return ride(errand);
    if (errand.then_rad) {
      turn_ = Turn{along_walls(wish_rad_ + *errand.then_rad + turn_error_rad_, kNarrow_rad), walked_m_};
    }
    errand_.reset();
    careful_until_ = truth_.t + kCareful;
    return;
  }
  const PathPoint& to = errand.points.front();
  const Point way = to.at - at();
  const double left_m = length_m(way);
  if (left_m < 0.01) {
    truth_.level = to.level;
    truth_.height_m = building_.height_m(to.level);
    errand.points.pop_front();
    return;
  }
  if (!turn_towards(heading(way)) && std::abs(turn_between(heading(way), truth_.heading_rad)) > 0.5) {
    pace_mps_ = 0.0;
    return;
  }
  const double limit = errand.stairs && errand.points.front().level != truth_.level ? options_.gait.stairs_speed_mps
                                                                                    : options_.gait.speed_mps;
  pace_mps_ = std::min(limit, pace_mps_ + options_.gait.acceleration_mps2 * kStep_s);
  const double step_m = std::min(left_m, pace_mps_ * kStep_s);
  const Point next = at() + way * (step_m / left_m);
  truth_.level += (to.level - truth_.level) * (step_m / left_m);
  truth_.height_m = building_.height_m(truth_.level);
  truth_.x_m = next.x_m;
  truth_.y_m = next.y_m;
  walked_m_ += step_m;
}

void GuidedWalker::ride(Errand& errand) {
  pace_mps_ = 0.0;
  turn_towards(wish_rad_);
  if (errand.wait_s > 0.0) {
    errand.wait_s -= kStep_s;
    return;
  }
  if (errand.ridden_s == 0.0) errand.from_m = truth_.height_m;
  errand.ridden_s += kStep_s;
  const double goal_m = building_.height_m(*errand.ride_to);
  const LiftRide lift(goal_m - errand.from_m);
  truth_.height_m = errand.from_m + lift.risen_m(errand.ridden_s);
  truth_.level = building_.plan().heights.level_at(truth_.height_m);
  if (errand.ridden_s < lift.duration_s()) return;
  truth_.height_m = goal_m;
  truth_.level = *errand.ride_to;
  if (errand.ridden_s < lift.duration_s() + kDoors_s) return;
  errand_.reset();
  careful_until_ = truth_.t + kCareful;
}

void GuidedWalker::walk() {
  if (!walking_) {
    pace_mps_ = std::max(0.0, pace_mps_ - 2.0 * options_.gait.acceleration_mps2 * kStep_s);
    if (pace_mps_ == 0.0) return;
  }
  turn_when_open();
  turn_towards(wish_rad_);
  // An Ornstein-Uhlenbeck process: nobody walks quite straight.
  const double noise = options_.veer_rad * std::sqrt(2.0 * kStep_s / kVeerTime_s);
  veer_rad_ += -veer_rad_ * kStep_s / kVeerTime_s + noise * random_.normal();
  const bool turned = std::abs(turn_between(wish_rad_, truth_.heading_rad)) < 0.5;
  const bool about_to = !heard_.empty() && is_done_here(heard_.front().said) &&
                        walked_m_ - heard_.front().walked_m > heard_.front().said.distance() - 0.3;
  const bool careful = truth_.t < careful_until_ || about_to;
  const double speed_mps = options_.gait.speed_mps * (careful ? kCarefulShare : 1.0);
  const double wanted = walking_ && turned ? speed_mps : 0.0;
  const double change = options_.gait.acceleration_mps2 * kStep_s;
  pace_mps_ = std::clamp(wanted, std::max(0.0, pace_mps_ - 2.0 * change), pace_mps_ + change);
  const Point before = at();
  move(direction(truth_.heading_rad + veer_rad_) * (pace_mps_ * kStep_s));
  const double moved_m = distance_m(before, at());
  walked_m_ += moved_m;
  follow_wall(at() - before, moved_m);
  blocked_s_ = walking_ && turned && moved_m < 0.3 * pace_mps_ * kStep_s ? blocked_s_ + kStep_s : 0.0;
  if (blocked_s_ < kBlockedFor_s) return;
  // In front of a wall one thinks again of what was said.
  blocked_s_ = 0.0;
  missed_.clear();
  done_.clear();
  if (last_) act(*last_);
}

/// Nobody walks sidewards: who comes to a wall aslant turns along it.
void GuidedWalker::follow_wall(Point moved, double moved_m) {
  if (moved_m < 0.3 * pace_mps_ * kStep_s || moved_m == 0.0) return;
  const double along_rad = heading(moved);
  if (std::abs(turn_between(along_rad, truth_.heading_rad + veer_rad_)) > kSlides_rad) wish_rad_ = along_rad;
}

void GuidedWalker::turn_when_open() {
  if (!turn_ || walked_m_ < turn_->at_m) return;
  const bool ends = free_m(at(), direction(truth_.heading_rad), 0.8) < 0.8;
  if (ends || free_m(at(), direction(turn_->direction_rad), kOpen_m) >= kOpen_m) {
    wish_rad_ = turn_->direction_rad;
    turn_.reset();
  } else if (walked_m_ > turn_->at_m + kTooLate_m) {
    turn_.reset();
  }
}

/// Pushes off walls, and so slides along them.
void GuidedWalker::move(Point by) {
  Point to = at() + by;
  for (int i = 0; i < 2; ++i) {
    for (const Segment& wall : near_walls()) {
      const Point along = wall.to - wall.from;
      const double length2 = dot(along, along);
      const double share = length2 > 0.0 ? std::clamp(dot(to - wall.from, along) / length2, 0.0, 1.0) : 0.0;
      const Point off = to - (wall.from + along * share);
      const double away_m = length_m(off);
      if (away_m < kBody_m && away_m > 1e-9) to = to + off * (kBody_m / away_m - 1.0);
    }
  }
  for (const Segment& wall : near_walls()) {
    if (building::crossing({at(), to}, wall)) return;
  }
  truth_.x_m = to.x_m;
  truth_.y_m = to.y_m;
}

void GuidedWalker::note_motion(Point before, double height_before_m) {
  truth_.velocity_x_mps = (truth_.x_m - before.x_m) / kStep_s;
  truth_.velocity_y_mps = (truth_.y_m - before.y_m) / kStep_s;
  truth_.velocity_up_mps = (truth_.height_m - height_before_m) / kStep_s;
  truth_.speed_mps = std::hypot(truth_.velocity_x_mps, truth_.velocity_y_mps);
  const bool climbs = std::abs(truth_.velocity_up_mps) > 0.05;
  const double most_mps = climbs ? options_.gait.stairs_speed_mps : options_.gait.speed_mps;
  const double share = std::clamp(truth_.speed_mps / most_mps, 0.0, 1.0);
  truth_.cadence_hz = options_.gait.cadence_hz * (climbs ? 0.9 : 1.0) * std::sqrt(share);
  truth_.steps += truth_.cadence_hz * kStep_s;
}

bool GuidedWalker::turn_towards(double heading_rad) {
  const double most = options_.gait.turn_rate_rad_s * kStep_s;
  const double rest = turn_between(heading_rad, truth_.heading_rad);
  truth_.heading_rad = around(truth_.heading_rad + std::clamp(rest, -most, most));
  return std::abs(rest) <= most;
}

void GuidedWalker::set_barriers() {
  for (const building::Wall& wall : building_.walls()) barriers_[wall.level].push_back(wall.segment);
  for (const building::Door& door : building_.doors()) {
    const Point half = building::left_of(door.normal) * (door.width_m / 2.0);
    barriers_[door.level].push_back({door.at - half, door.at + half});
  }
}

bool GuidedWalker::sees(Point from, Point to) const {
  const auto level = barriers_.find(truth_.level);
  return level == barriers_.end() || std::none_of(level->second.begin(), level->second.end(), [&](const Segment& one) {
           return building::crossing({from, to}, one).has_value();
         });
}

double GuidedWalker::free_m(Point from, Point towards, double most_m) const {
  double free = most_m;
  const Segment ray{from, from + towards * most_m};
  const auto level = barriers_.find(truth_.level);
  if (level == barriers_.end()) return free;
  for (const Segment& one : level->second) {
    if (const auto share = building::crossing(ray, one)) free = std::min(free, *share * most_m);
  }
  return free;
}

/// In a corridor one walks along its walls, not exactly where one was told.
double GuidedWalker::along_walls(double direction_rad, double most_rad) const {
  constexpr double kBeside_m = 3.0;
  double best = direction_rad;
  double nearest_m = kBeside_m;
  for (const building::Wall& wall : building_.walls()) {
    const double away_m = distance_m(at(), wall.segment);
    if (wall.level != truth_.level || away_m > nearest_m || length_m(wall.segment.to - wall.segment.from) < 1.0)
      continue;
    const double along = heading(wall.segment.to - wall.segment.from);
    for (const double side : {along, along + std::numbers::pi}) {
      if (std::abs(turn_between(side, direction_rad)) > most_rad) continue;
      best = side;
      nearest_m = away_m;
    }
  }
  return around(best);
}

Point GuidedWalker::direction(double heading_rad) const {
  const double local = heading_rad - building_.reference().heading_rad;
  return {std::sin(local), std::cos(local)};
}

double GuidedWalker::heading(Point towards) const {
  return around(std::atan2(towards.x_m, towards.y_m) + building_.reference().heading_rad);
}

const std::vector<Segment>& GuidedWalker::near_walls() {
  constexpr double kReach_m = 3.0;
  if (!walls_at_ || walls_at_->level != truth_.level || distance_m(walls_at_->at, at()) > kReach_m / 2.0) {
    walls_at_ = PathPoint{at(), truth_.level};
    walls_.clear();
    for (const Segment& one : barriers_[truth_.level]) {
      if (distance_m(at(), one) < kReach_m) walls_.push_back(one);
    }
  }
  return walls_;
}

}  // namespace fiona::simulator
