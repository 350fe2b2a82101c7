#include "navigation.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include <fiona/building/declination.hpp>
#include <fiona/building/frames.hpp>
#include <fiona/building/geometry.hpp>
#include <fiona/building/levels.hpp>

#include "fiona/objects/landmark.hpp"
#include "words.hpp"

namespace fiona::guidance {
namespace {

using building::PathPoint;
using building::Point;
using hmi::Instruction;
using navigation::CommPlan;
using namespace std::chrono_literals;

/// A provider of places is silent after so long; the person is told, and does not walk on.
constexpr auto kLost = 1500ms;
constexpr auto kAgain = 2s;
constexpr auto kShownCycle = 200ms;
constexpr auto kProfileDeadline = 500ms;
constexpr auto kProfilePeriod = 5s;
constexpr auto kPlannerGrace = 500ms;
constexpr auto kOnStairs = 5s;
/// The place of one who is led from it is surer than that, or has been looked for so long.
constexpr double kFound_m = 4.0;
constexpr auto kSoughtFor = 10s;
constexpr const char* kNotSure =
    "It is not sure yet where you are. Leave the room that you are in, or walk some steps.";
/// Without a compass the course tells where a person looks: over so much way, and for so long.
constexpr double kCourse_m = 1.0;
constexpr auto kCourseFor = 4s;
constexpr double kFastest_mps = 4.0;  // who is faster was elsewhere before
constexpr auto kLevelHolds = 10s;
constexpr int kMostWaypoints = 4096;
/// 95 % of two dimensions lie within so many standard deviations.
constexpr double kRegionSigmas = 2.4477;

bool is_same(const building::RouteOptions& a, const building::RouteOptions& b) {
  return a.stairs == b.stairs && a.lift == b.lift && a.outdoors == b.outdoors && a.access == b.access;
}

/// Unknown is no certainty: as wide as a region is in which the place is just not told to be uncertain, and in which
/// one can just arrive.
Covariance covariance_of(const localisation::CommPosition& position, double uncertain_radius_m) {
  if (position.confidence_size() != 9) {
    const double variance_m2 = std::pow(std::min(uncertain_radius_m / kRegionSigmas, Situation::kMostThere_m), 2);
    return {variance_m2, 0.0, variance_m2};
  }
  return {std::max(0.0, position.confidence(0)), position.confidence(1), std::max(0.0, position.confidence(4))};
}

/// Where who holds the device looks, counter-clockwise from magnetic north: to where its top points, or, as it is held
/// upright and the top points to the ceiling, its back; between 45 and 70 degrees something of both. Of an attitude
/// that turns by yaw, pitch and roll (CommOrientation).
double looks_rad(const localisation::CommOrientation& orientation) {
  constexpr double kTop_deg = 45.0, kBack_deg = 70.0;
  const double cy = std::cos(orientation.yaw()), sy = std::sin(orientation.yaw());
  const double cp = std::cos(orientation.pitch()), sp = std::sin(orientation.pitch());
  const double cr = std::cos(orientation.roll()), sr = std::sin(orientation.roll());
  const Point top{cy * cp, sy * cp};
  const Point back{-cy * cr * sp - sy * sr, -sy * cr * sp + cy * sr};
  const double rises_deg = std::asin(std::clamp(-sp, -1.0, 1.0)) * 180.0 / std::numbers::pi;
  const double upright = std::clamp((rises_deg - kTop_deg) / (kBack_deg - kTop_deg), 0.0, 1.0);
  const Point ahead = top * (1.0 - upright) + back * upright;
  return std::atan2(ahead.y_m, ahead.x_m);
}

/// Why a call to another component gave nothing.
template <class T>
std::string reason_of(const Result<T>& result) {
  switch (result.outcome()) {
    case Outcome::Timeout: return "it does not answer";
    case Outcome::Unwired: return "there is none";
    case Outcome::Rejected: return result.reason();
    default: return "it is gone";
  }
}

}  // namespace

/// Who is led by nobody is told so: what another guide has said, or this one before it was started anew, holds no more.
void Navigation::on_mode(std::string_view mode) {
  if (mode == kModeNeutral || guide_) return;
  put_path(nullptr);
  instructions_.put(said_);
}

void Navigation::on_destination(const navigation::CommDestination& wish) {
  end_guidance();
  trip_ = Trip{.number = ++trips_, .wish = wish};
  plan_due_at_ = now();
  ask_for(wish.user_name(), wish.session());
  // Who asks again is answered again; until there is a way, what led to the last destination holds no more.
  if (std::exchange(said_, {}).kind() != Instruction::KIND_UNSPECIFIED) instructions_.put(said_);
  turn_.put(hmi::NextTurn());
  const bool is_told_of_changes = watches_ && change_.connection() == Connection::Connected;
  if (!is_told_of_changes) map_due_at_ = now();
}

/// They are known from then on until they log out, or another one wants to go somewhere.
void Navigation::ask_for(const std::string& user_name, const std::string& session) {
  if (user_.user_name() != user_name || user_.session() != session) passing_.watch({});
  user_.set_user_name(user_name);
  user_.set_session(session);
  options_ = {.access = 0};
  has_profile_ = false;
  profile_fault_.clear();
  profile_due_at_ = now();
}

void Navigation::on_map_change(const Fired<navigation::LevelMapVersion>& change) {
  if (!map_ || map_->plan.version != change->version()) map_due_at_ = now();
}

/// What waits for nobody: a person whose place is lost is told so though the planner is silent, too.
void Navigation::tell() {
  watch_location();
  show_again();
  instructions_.still_valid();
  turn_.still_valid();
  path_.still_valid();
}

/// All that guidance waits for is done here, one after the other.
Async<> Navigation::work() {
  if (is_due(map_due_at_)) co_await fetch_map();
  if (is_due(profile_due_at_)) co_await ask_profile();
  if (trip_ && is_due(plan_due_at_)) co_await plan();
}

/// With no version, which each provider's differs from: whoever serves next tells its own at once.
Async<> Navigation::watch_map() {
  if (watches_ || change_.connection() != Connection::Connected) co_return;
  const auto activation = co_await change_.activate(EventMode::Continuous, {});
  watches_ = activation.ok();
}

/// 0 where the map tells no place.
double Navigation::declination() const {
  const auto& at = map_->plan.reference;
  if (!at) return 0.0;
  return building::declination_rad(at->latitude_deg, at->longitude_deg,
                                   std::chrono::milliseconds(to_milliseconds(now())));
}

/// Where both say which frame theirs is: another supplier's, or a map that was learnt before the building was drawn
/// anew, may have another one.
void Navigation::move_to_map(localisation::CommPosition& position) {
  const auto own = reference_of(position);
  if (!own || !map_ || !map_->plan.reference) return;
  const building::Reference& map = *map_->plan.reference;
  const bool is_same = own->latitude_deg == map.latitude_deg && own->longitude_deg == map.longitude_deg &&
                       own->heading_rad == map.heading_rad;
  if (is_same) return;
  const building::Placement placement = building::placement_of(*own, map);
  if (!std::exchange(told_of_frame_, true)) {
    log(LogLevel::Info, "places are told in a frame of their own, whose origin lies " +
                            metres(building::length_m(placement.by)) + " from the map's: they are moved to the map's");
  }
  const Point at = placement.place(Point{position.x(), position.y()});
  position.set_x(at.x_m);
  position.set_y(at.y_m);
  if (position.confidence_size() == 9) {
    const auto turned = placement.place(
        building::Placement::Covariance{position.confidence(0), position.confidence(1), position.confidence(4)});
    position.set_confidence(0, turned.xx_m2);
    position.set_confidence(1, turned.xy_m2);
    position.set_confidence(3, turned.xy_m2);
    position.set_confidence(4, turned.yy_m2);
  }
  position.set_reference_lat(map.latitude_deg);
  position.set_reference_long(map.longitude_deg);
  position.set_reference_heading(map.heading_rad * 180.0 / std::numbers::pi);
}

Async<> Navigation::fetch_map() {
  map_due_at_.reset();
  const auto answer = co_await levels_.query({});
  std::string fault;
  try {
    if (answer) {
      map_ = std::make_shared<Map>(read_level_plan(**answer));
      declination_rad_ = declination();
    } else {
      fault = "there is no map of the building: " + reason_of(answer);
    }
  } catch (const Error& error) {
    fault = error.text().what;
  }
  if (!fault.empty()) {
    if (fault != map_fault_) log(LogLevel::Warning, fault);
    // A map that cannot be read is not led by, and neither is the one before it: a door may be closed.
    map_.reset();
    if (!map_due_at_) map_due_at_ = now() + kAgain;
  }
  map_fault_ = std::move(fault);
  plan_due_at_ = now();
}

/// What a profile says holds from then on; one that cannot be had just now stays as it was.
Async<> Navigation::ask_profile() {
  const std::uint64_t number = trips_;
  const bool is_guest = user_.user_name().empty() && user_.session().empty();
  const auto answer = co_await profile_.query(user_, kProfileDeadline);
  if (number != trips_) co_return;  // another user's, perhaps
  const bool has_answer = answer || (is_guest && answer.outcome() == Outcome::Unwired);
  profile_due_at_ = now() + (has_answer ? Duration(kProfilePeriod) : Duration(kAgain));
  if (answer && (*answer)->session_ended()) co_return forget_user();
  const building::RouteOptions before = options_;
  if (answer) take_profile(**answer);
  if (!has_answer) profile_fault_ = "Your profile cannot be had: " + reason_of(answer) + ".";
  if (!has_profile_ || !is_same(options_, before)) plan_due_at_ = now();
  has_profile_ = has_profile_ || has_answer;
}

void Navigation::take_profile(const hmi::CommUserProfileReply& profile) {
  options_ = {.stairs = !profile.has_use_stairs() || profile.use_stairs(),
              .lift = !profile.has_use_elevator() || profile.use_elevator(),
              .outdoors = !profile.has_use_outdoor_navigation() || profile.use_outdoor_navigation(),
              .access = profile.authentication_level()};
  std::vector<Landmark> points;
  for (const std::string& text : profile.landmark_list()) {
    if (const auto point = hmi::parse_landmark(text)) {
      points.push_back({{{point->x(), point->y()}, point->level()}, point->name()});
    } else if (!std::exchange(refused_point_, true)) {
      log(LogLevel::Warning, "a point of attention is no 'X,Y,Z NAME': " + text);
    }
  }
  passing_.watch(std::move(points));
}

/// Whoever has logged out is neither led nor told of their points.
void Navigation::forget_user() {
  user_.Clear();
  profile_due_at_.reset();
  passing_.watch({});
  if (!trip_) return;
  end_guidance();
  trip_.reset();
  say(Instruction::NO_PATH, "You are not led any more: you have been logged out. Log in again, or go on as a guest.");
}

/// Who may be in one of several rooms is found once they move.
bool Navigation::is_sought() {
  if (trip_->begun || walker_->sigma_m <= kFound_m) return false;
  if (!trip_->sought_since) trip_->sought_since = now();
  if (now() - *trip_->sought_since > kSoughtFor) return false;
  say(Instruction::START, kNotSure);
  return true;
}

/// In the frame of the map that is planned on: it may have come later than the destination.
PathPoint Navigation::goal() {
  localisation::CommPosition place = trip_->wish.destination();
  move_to_map(place);
  return {{place.x(), place.y()}, place.z()};
}

Async<> Navigation::plan() {
  const std::uint64_t number = trip_->number;
  trip_->goal = goal();
  const auto from = start();
  const bool has_asked = has_profile_ || !profile_fault_.empty();
  if (!from || !has_asked) co_return;
  std::optional<Refusal> refusal;
  if (!map_) {
    refusal = Refusal{"The way cannot be planned: " + map_fault_ + ".", {}};
  } else {
    refusal = check(*trip_);
  }
  if (!refusal && is_sought()) co_return;
  plan_due_at_.reset();
  if (!refusal && !has_profile_) refusal = Refusal{profile_fault_, {}};
  if (!refusal) refusal = co_await find_path(*from);
  if (!is_trip(number) || !refusal) co_return;
  end_guidance();
  say(refusal->kind, refusal->text);
  if (refusal->again) plan_due_at_ = now() + *refusal->again;
}

std::optional<Navigation::Refusal> Navigation::check(const Trip& trip) const {
  const localisation::CommPosition& place = trip.wish.destination();
  if (!place.is_valid()) return Refusal{"The destination is not a valid place.", {}};
  if (!place.has_z()) return Refusal{"The destination has no level: destinations are indoors.", {}};
  if (!map_->plan.level_near(place.z(), 0.0)) {
    return Refusal{map_->plan.name + " has no level " + building::level_text(place.z()) + ".", {}};
  }
  if (building::approaches(map_->plan.plan, map_->plan.graph, trip.goal).empty()) {
    return Refusal{"The destination is in no room of " + map_->plan.name + ".", {}};
  }
  return std::nullopt;
}

/// Where to plan from. On stairs and in a lift that waits until a level is reached, for a while.
std::optional<PathPoint> Navigation::start() {
  if (!walker_ || now() - located_ > kLost) return std::nullopt;  // told already
  if (!map_) return walker_->place;
  auto level = map_->plan.level_near(walker_->place.level, 0.3);
  if (!level) {
    if (!between_levels_) between_levels_ = now();
    if (now() - *between_levels_ < kOnStairs) return std::nullopt;
    level = map_->plan.level_near(walker_->place.level, 1.0);
  } else {
    between_levels_.reset();
  }
  return PathPoint{walker_->place.at, level.value_or(walker_->place.level)};
}

Async<std::optional<Navigation::Refusal>> Navigation::find_path(PathPoint from) {
  const std::shared_ptr<Map> map = map_;
  const std::uint64_t number = trip_->number;
  if (building::approaches(map->plan.plan, map->plan.graph, from).empty()) {
    co_return Refusal{"You are at a place from which the map knows no way. Go to a corridor or a room.", kAgain};
  }
  if (!map->tasks || !map->tasks->suits(from, options_)) {
    map->tasks = std::make_unique<TaskGraph>(map->plan, from, options_);
  }
  const TaskGraph::Request request = map->tasks->request(from, trip_->goal);
  navigation::CommPlanRequest question;
  question.set_domain(task_domain());
  question.set_problem(request.problem());
  question.set_search(navigation::CommPlanRequest::OPTIMAL);
  question.set_time_bound(params_->planning_time());
  const Duration deadline = std::chrono::milliseconds(params_->planning_time()) + kPlannerGrace;
  const auto answer = co_await planner_.query(std::move(question), deadline);
  if (!is_trip(number)) co_return std::nullopt;
  if (!answer) co_return Refusal{"The way cannot be planned: the planner fails, " + reason_of(answer) + ".", kAgain};
  const CommPlan& plan = **answer;
  planned_in_.set(plan.time());
  if (plan.outcome() == CommPlan::UNSOLVABLE) {
    Refusal refusal = no_way(*map, from);
    // From where they really are there may be one.
    if (!walker_->is_sure()) refusal.again = kAgain;
    co_return refusal;
  }
  if (plan.outcome() != CommPlan::SOLVED) {
    log(LogLevel::Warning, "the planner: " + plan.message());
    co_return Refusal{"The way cannot be planned: " + plan.message() + ".", kAgain};
  }
  try {
    begin_guidance(map, request.route(plan));
  } catch (const Error& error) {
    log(LogLevel::Error, error.what());
    co_return Refusal{"The way cannot be planned: " + error.text().what + ".", kAgain};
  }
  co_return std::nullopt;
}

/// Which wish of the profile stands in the way.
Navigation::Refusal Navigation::no_way(const Map& map, const PathPoint& from) const {
  const auto leads = [&](const building::RouteOptions& options) {
    return building::find_route(map.plan.plan, map.plan.graph, from, trip_->goal, options).has_value();
  };
  building::RouteOptions more = options_;
  const std::string to = goal_name();
  const std::string no = "There is no way to " + to;
  more.access = 9;
  if (leads(more)) {
    // Nobody is behind a door that is closed to them: the place that localisation says is likely another one.
    const auto room = building::room_index_at(map.plan.plan, from.at, from.level);
    const bool shut_in = room && map.plan.plan.rooms[*room].access > options_.access;
    if (shut_in && !walker_->is_sure()) return {kNotSure, kAgain, Instruction::START};
    return {no + " that is open to you: doors on it need another right.",
            shut_in ? std::optional<Duration>(kAgain) : std::nullopt};
  }
  more = options_, more.stairs = true;
  if (leads(more)) return {no + " without stairs, and your profile leaves stairs out.", {}};
  more = options_, more.lift = true;
  if (leads(more)) return {no + " without a lift, and your profile leaves lifts out.", {}};
  more = options_, more.outdoors = true;
  if (leads(more)) return {no + " within the building, and your profile stays indoors.", {}};
  if (leads({})) return {no + " that your profile allows.", {}};
  return {no + " from here.", {}};
}

std::string Navigation::goal_name() const {
  const auto room = map_ ? map_->plan.room_name(trip_->goal) : std::nullopt;
  return room && !room->empty() ? *room : "the destination";
}

void Navigation::begin_guidance(std::shared_ptr<Map> map, building::Route route) {
  if (route.points.size() > static_cast<std::size_t>(kMostWaypoints)) {
    throw Error(ErrorCode::Failed,
                {.what = "the way has " + std::to_string(route.points.size()) + " places, more than a path may",
                 .expected = "at most " + std::to_string(kMostWaypoints),
                 .next = "pick a place that is nearer, and go on from there"});
  }
  const bool first = !std::exchange(trip_->begun, true);
  guide_.reset();
  led_by_ = std::move(map);
  guide_.emplace(led_by_->plan, std::move(route), goal_name(), first, now(),
                 first ? trip_->sought_since : std::nullopt);
  other_said_ = true;
  plans_.set(++plans_count_);
  put_path(&guide_->path().route());
  lead();
}

void Navigation::end_guidance() {
  if (guide_) put_path(nullptr);
  guide_.reset();
  led_by_.reset();
}

void Navigation::on_location(const Received<localisation::CommLocation>& told) {
  if (!told->is_valid() || !told->position().is_valid()) return;
  localisation::CommLocation location = *told;
  if (!knows_level(*location.mutable_position())) return;
  move_to_map(*location.mutable_position());
  const localisation::CommPosition& position = location.position();
  const building::Point at{position.x(), position.y()};
  const Covariance covariance = covariance_of(position, params_->uncertain_radius());
  const ShownPosition::Shown shown = blender_.follow({at, position.z()}, covariance, now());
  note_heading(location, shown.blending);
  std::optional<double> heading = course_rad_;
  if (location.orientation().is_valid()) {
    heading = declination_rad_ - looks_rad(location.orientation());
  }
  // What is shown moves over; guidance is to know at once.
  walker_ = Walker{{at, position.z()}, heading, covariance.sigma_m()};
  uncertain_ = shown.blending || position.confidence().empty() ||
               kRegionSigmas * shown.covariance.sigma_m() > params_->uncertain_radius();
  located_ = now();
  put_shown(std::move(location), shown, told.origin);
  lead();
  say_again();
  tell_passed_points();
}

/// A place whose level is not told is on the last one that was, for a while.
bool Navigation::knows_level(localisation::CommPosition& position) {
  if (position.has_z()) {
    level_told_ = now();
    return true;
  }
  if (!std::exchange(told_of_level_, true))
    log(LogLevel::Warning, "the location tells no level: nobody is led by that");
  if (!walker_ || !level_told_ || now() - *level_told_ > kLevelHolds) return false;
  position.set_z(walker_->place.level);
  return true;
}

/// Where a place leaps nobody walks.
void Navigation::note_heading(const localisation::CommLocation& location, bool leaps) {
  const Point at{location.position().x(), location.position().y()};
  if (course_from_ && !leaps) {
    const double way_m = length_m(at - course_from_->first);
    leaps = way_m > kCourse_m && way_m > kFastest_mps * to_seconds(now() - course_from_->second);
  }
  if (leaps) {
    course_from_ = {at, now()};
  } else if (!course_from_ || now() - course_from_->second > kCourseFor) {
    if (course_from_) course_rad_.reset();
    course_from_ = {at, now()};
  } else if (const Point way = at - course_from_->first; length_m(way) > kCourse_m) {
    course_rad_ = std::atan2(way.x_m, way.y_m) + (map_ ? map_->plan.heading_rad : 0.0);
    course_from_ = {at, now()};
  }
}

void Navigation::watch_location() {
  if (walker_ && now() - located_ <= kLost) return;
  blender_.forget();
  course_from_.reset();
  course_rad_.reset();
  say_again();
  if (!trip_) return;
  say(Instruction::LOST, walker_ ? "Your place is not known any more. Stop, and wait."
                                 : "Your place is not known yet. Stay where you are.");
  // Whoever is not led, because there is no way, is to hear so again, and not to wait for ever.
  if (!guide_) plan_due_at_ = now();
}

void Navigation::lead() {
  if (!guide_ || !walker_) return;
  const Guide::Advice advice = guide_->follow(*walker_, now());
  if (advice.off_path) {
    reroutes_.set(++reroutes_count_);
    end_guidance();
    plan_due_at_ = now();
    return say(Instruction::REROUTE, "You have left the path. Stop: another one is being planned.");
  }
  const bool again = std::exchange(other_said_, false);
  say(advice.instruction, advice.is_new || again);
  turn_.put(advice.turn);
  if (!advice.arrived) return;
  end_guidance();
  trip_.reset();
}

void Navigation::tell_passed_points() {
  if (!map_) return;
  for (const Landmark& point : passing_.follow(map_->plan, walker_->place, params_->attention_distance())) {
    Instruction attention;
    attention.set_kind(Instruction::ATTENTION);
    attention.set_text("You are passing " + (point.name.empty() ? "a point of attention" : point.name) + ".");
    attention.set_language("en");
    attention.set_level(point.place.level);
    attention.set_distance(distance_m(walker_->place.at, point.place.at));
    attention.set_number(++number_);
    attention.set_uncertain(uncertain_);
    instructions_.put(attention);
    attends_ = true;
  }
}

/// A point of attention stands beside the instruction that holds, and not in its place; and who has arrived is told
/// when their place is in doubt, and when it is no more.
void Navigation::say_again() {
  const bool attended = std::exchange(attends_, false);
  const bool in_doubt = uncertain_ || said_.kind() == Instruction::LOST;
  const bool doubts_otherwise = said_.kind() == Instruction::ARRIVE && said_.uncertain() != in_doubt;
  if ((!attended && !doubts_otherwise) || said_.kind() == Instruction::KIND_UNSPECIFIED) return;
  said_.set_uncertain(in_doubt);
  instructions_.put(said_);
}

/// The same sentence is said once; who comes later is given it by the service.
void Navigation::say(Instruction::Kind kind, const std::string& text) {
  const bool is_new = said_.kind() != kind || said_.text() != text;
  if (!is_new) return;
  Instruction instruction;
  instruction.set_kind(kind);
  instruction.set_text(text);
  instruction.set_language("en");
  say(std::move(instruction), true);
  turn_.put(hmi::NextTurn{});  // no direction
  other_said_ = true;
}

void Navigation::say(Instruction instruction, bool is_new) {
  if (is_new) ++number_;
  instruction.set_number(is_new ? number_ : said_.number());
  instruction.set_uncertain(uncertain_ || instruction.kind() == Instruction::LOST);
  said_ = instruction;
  attends_ = false;
  instructions_.put(std::move(instruction));
}

void Navigation::put_shown(localisation::CommLocation told, const ShownPosition::Shown& shown, TimePoint origin) {
  localisation::CommPosition& position = *told.mutable_position();
  position.set_x(shown.at.x_m);
  position.set_y(shown.at.y_m);
  if (shown.blending) position.mutable_confidence()->Resize(9, 0.0);
  if (position.confidence_size() == 9) {
    position.set_confidence(0, shown.covariance.xx_m2);
    position.set_confidence(1, shown.covariance.xy_m2);
    position.set_confidence(3, shown.covariance.xy_m2);
    position.set_confidence(4, shown.covariance.yy_m2);
  }
  last_shown_ = std::move(told);
  shown_origin_ = origin;
  shown_.put(*last_shown_, shown_origin_);
  shown_at_ = now();
}

/// Two localisations are out of step, and a swap between them leaves a gap: the last place fills it, with its own time.
void Navigation::show_again() {
  if (!last_shown_ || now() - shown_at_ <= kShownCycle || now() - located_ > kLost) return;
  shown_.put(*last_shown_, shown_origin_);
  shown_at_ = now();
}

void Navigation::put_path(const building::Route* route) {
  navigation::CommPath path;
  path.set_is_valid(route != nullptr);
  if (route) {
    for (const building::RoutePoint& point : route->points) {
      localisation::CommPosition& waypoint = *path.add_waypoints();
      waypoint.set_x(point.at.x_m);
      waypoint.set_y(point.at.y_m);
      waypoint.set_z(point.level);
      waypoint.set_is_valid(true);
      if (path.waypoints_size() > 1) path.add_legs(kind_of(point));
    }
  }
  path_.put(std::move(path));
}

}  // namespace fiona::guidance
