#include "guided_walk.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <numbers>

#include "fiona/building/geometry.hpp"
#include "fiona/simulator/building_simulator.hpp"
#include "fiona/simulator/random.hpp"
#include "led_path.hpp"
#include "map_server.hpp"
#include "navigation.hpp"
#include "smart_bluetooth_localization.hpp"
#include "stage.hpp"
#include "step_heading.hpp"
#include "symbolic_planner.hpp"

namespace fiona::walks {
namespace {

using building::Building;
using building::Point;
using building::Room;
using hmi::Instruction;
using namespace std::chrono_literals;

constexpr double kShortest_m = 15.0;
constexpr double kInTime = 1.5;  ///< of the route's time, to the door
constexpr double kAtLast = 2.0;  ///< of the route's time, until one is told to be there
constexpr double kAtDoor_m = 2.0;
constexpr std::size_t kMostFaults = 20;
constexpr auto kPicksIn = 15s;
constexpr double kDeclination_rad = 4.0 * std::numbers::pi / 180.0;  ///< as all are told

/// Stands between navigation and the walker: asks for the destination, has the profile, passes on what is said, and
/// sees where the walker really is.
class Referee final : public Component {
 public:
  using Component::Component;

  void begin(const Building& building, const Errand& errand, Guidance guidance, Place place) {
    building_ = &building;
    check_.emplace(building, errand.profile);
    errand_ = errand;
    guidance_ = guidance;
    place_ = place;
  }
  void send() {
    navigation::CommDestination wish;
    auto& place = *wish.mutable_destination();
    place.set_x(errand_.to->centre.x_m);
    place.set_y(errand_.to->centre.y_m);
    place.set_z(errand_.to->level);
    place.set_is_valid(true);
    destination_.send(std::move(wish));
    begun_ = now();
  }
  bool ended() const { return !outcome.ending.empty(); }
  bool was_in_time() const { return outcome.at_door_s && *outcome.at_door_s <= kInTime * errand_.route_s; }
  bool is_placed() const { return told_ && told_->is_valid(); }

  /// To be called once a second.
  void judge() {
    if (!is_placed()) {
      ++outcome.unplaced;
    } else {
      const auto& told = told_->position();
      outcome.errors_m.push_back(distance_m({told.x(), told.y()}, at_));
      outcome.inside += is_inside(told);
      outcome.wrong_level += std::abs(told.z() - level_) > 0.75;
    }
    note_course();
  }

  Outcome outcome;

 private:
  /// By Mahalanobis distance; 5.991 is the 95 % quantile of chi-square with two degrees of freedom.
  bool is_inside(const localisation::CommPosition& told) const {
    if (told.confidence_size() != 9) return false;
    const double xx = told.confidence(0), xy = told.confidence(1), yy = told.confidence(4);
    const double x = told.x() - at_.x_m, y = told.y() - at_.y_m;
    return yy * x * x - 2.0 * xy * x * y + xx * y * y <= 5.991 * (xx * yy - xy * xy);
  }

  void note(const char* format, auto... values) {
    char line[200];
    std::snprintf(line, sizeof line, format, values...);
    outcome.course.emplace_back(line);
  }
  void note_course() {
    constexpr double kDegree = std::numbers::pi / 180.0;
    const double heading = yaw_rad_ / kDegree;
    if (!is_placed())
      return note("%6.1f s  %6.2f %6.2f %5.2f %5.0f", since_begun_s(), at_.x_m, at_.y_m, level_, heading);
    const auto& told = told_->position();
    const double sd_m = told.confidence_size() == 9 ? std::sqrt(told.confidence(0) + told.confidence(4)) : 0.0;
    const double turned = std::remainder(told_->orientation().yaw() - yaw_rad_, 2.0 * std::numbers::pi) / kDegree;
    const double compass = std::remainder(compass_rad_ - yaw_rad_, 2.0 * std::numbers::pi) / kDegree;
    note(
        "%6.1f s  %6.2f %6.2f %5.2f %5.0f  taken for %6.2f %6.2f %5.2f, %4.1f m off, sd %4.1f m, heading %+4.0f, "
        "compass %+4.0f",
        since_begun_s(), at_.x_m, at_.y_m, level_, heading, told.x(), told.y(), told.z(),
        distance_m({told.x(), told.y()}, at_), sd_m, turned, compass);
  }
  double since_begun_s() const { return begun_ ? to_seconds(now() - *begun_) : 0.0; }

  hmi::CommUserProfileReply on_profile(const hmi::CommUserProfileRequest&) {
    hmi::CommUserProfileReply profile;
    profile.set_use_stairs(errand_.profile.stairs);
    profile.set_use_elevator(errand_.profile.lift);
    profile.set_use_outdoor_navigation(errand_.profile.outdoors);
    profile.set_authentication_level(errand_.profile.access);
    return profile;
  }

  void on_truth(const localisation::CommLocation& location) {
    at_ = {location.position().x(), location.position().y()};
    level_ = location.position().z();
    yaw_rad_ = location.orientation().yaw();
    if (!start_at_) start_at_ = location.position();
    localisation::CommLocation fixed = location;
    *fixed.mutable_position() = *start_at_;
    start_.put(std::move(fixed));
    if (begun_ && !outcome.at_door_s && is_at_door()) outcome.at_door_s = to_seconds(now() - *begun_);
  }

  bool is_at_door() const {
    const Room& goal = *errand_.to;
    for (const building::Door& door : building_->doors()) {
      if (door.level != goal.level || level_ != goal.level || distance_m(door.at, at_) > kAtDoor_m) continue;
      for (const building::Segment& side : building::edges(goal.polygon)) {
        if (distance_m(door.at, side) < 0.05) return true;
      }
    }
    return false;
  }

  void on_location(const localisation::CommLocation& location) {
    told_ = location;
    note_progress();
  }
  void on_compass(const localisation::CommOrientation& compass) { compass_rad_ = compass.yaw(); }

  void on_instruction(const Instruction& said) {
    outcome.instructions = outcome.instructions * 1099511628211u ^ (std::hash<std::string>()(said.SerializeAsString()) +
                                                                    static_cast<std::uint64_t>(to_milliseconds(now())));
    if (said.number() != number_) {
      check(said);
      note("%6.1f s    \"%s\" (%u, hour %d, %.1f m)", since_begun_s(), said.text().c_str(), said.number(),
           static_cast<int>(said.hour()), said.distance());
    }
    number_ = said.number();
    check_way(said);
    if (said.kind() == Instruction::REROUTE) ++outcome.reroutes;
    if (said.kind() == Instruction::ARRIVE) end_at_goal();
    // A localisation that errs may have one behind a closed door for a while.
    if (said.kind() == Instruction::NO_PATH && place_ == Place::Truth) outcome.ending = "told: " + said.text();
    Instruction told = said;
    if (guidance_ == Guidance::Muted) {
      told.Clear();
      told.set_number(said.number());
      told.set_kind(Instruction::CONTINUE);
    }
    passed_on_.put(std::move(told));
  }

  void check(const Instruction& said) {
    const bool to_do =
        said.kind() >= Instruction::TURN && said.kind() <= Instruction::LEAVE && said.kind() != Instruction::CONTINUE;
    if (to_do && said.distance() > 8.0) fault(said.text() + " at " + std::to_string(said.distance()) + " m");
    if (said.uncertain() && place_ == Place::Truth) fault("uncertain with the true place");
    if (led_) led_->hear(said);
  }

  /// Distance and hour are another word each time; a fault is counted once.
  void check_way(const Instruction& said) {
    if (!led_ || said.number() == wrong_number_) return;
    const std::string wrong = led_->fault_of(said, believed());
    if (wrong.empty()) return;
    wrong_number_ = said.number();
    fault("told \"" + said.text() + "\", " + wrong);
  }

  Believed believed() const {
    const auto& place = told_->position();
    Believed walker{{{place.x(), place.y()}, place.z()}, std::nullopt, 0.0};
    if (told_->orientation().is_valid()) walker.heading_rad = kDeclination_rad - told_->orientation().yaw();
    if (place.confidence_size() == 9) {
      const double xx = place.confidence(0), xy = place.confidence(1), yy = place.confidence(4);
      walker.sigma_m = std::sqrt(std::max(0.0, (xx + yy) / 2.0 + std::hypot((xx - yy) / 2.0, xy)));
    }
    return walker;
  }

  void note_progress() {
    if (!led_ || !is_placed()) return;
    led_->walk(believed(), {at_, level_});
    for (const Announcement& one : led_->take_passed()) {
      if (const std::string wrong = one.fault(); !wrong.empty()) note_wrong(outcome.untimely, wrong);
      outcome.announcements.push_back(one);
    }
  }

  void end_at_goal() {
    const Room& goal = *errand_.to;
    outcome.told_so = is_at_door() || (level_ == goal.level && building::contains(goal.polygon, at_));
    outcome.arrived = outcome.told_so && was_in_time();
    outcome.ending = !outcome.told_so ? "told to have arrived elsewhere" : outcome.arrived ? "arrived" : "late";
  }

  void on_path(const navigation::CommPath& path) {
    led_.reset();
    if (!path.is_valid() || path.waypoints().empty()) return;
    if (std::string wrong = check_->fault_of(path); !wrong.empty()) fault(wrong);
    led_.emplace(*building_, *check_, path);
    note_progress();
  }

  void fault(const std::string& text) { note_wrong(outcome.faults, text); }

  void note_wrong(std::vector<std::string>& list, const std::string& text) {
    if (list.size() == kMostFaults) return;
    note("%6.1f s  ! %s", since_begun_s(), text.c_str());
    list.push_back("after " + std::to_string(std::lround(since_begun_s())) + " s " + text);
  }

  const Building* building_ = nullptr;
  std::optional<WordCheck> check_;
  std::optional<LedPath> led_;
  Errand errand_;
  Guidance guidance_ = Guidance::Whole;
  Place place_ = Place::Truth;
  std::optional<localisation::CommLocation> told_;
  std::optional<localisation::CommPosition> start_at_;
  std::optional<TimePoint> begun_;
  Point at_{};
  double level_ = 0.0;
  double yaw_rad_ = 0.0;
  double compass_rad_ = 0.0;
  std::uint32_t number_ = 0, wrong_number_ = 0;

  Provides<hmi::ProfileProvider> profile_{*this, "profile", &Referee::on_profile};
  Provides<localisation::LocationProvider> start_{*this, "start"};
  Provides<hmi::InstructionProvider> passed_on_{*this, "passed_on"};
  Requires<navigation::DestinationProvider> destination_{*this, "destination"};
  Requires<navigation::PathProvider> path_{*this, "path", &Referee::on_path};
  Requires<hmi::InstructionProvider> instructions_{*this, "instructions", &Referee::on_instruction};
  Requires<localisation::LocationProvider> truth_{*this, "truth", &Referee::on_truth};
  Requires<localisation::LocationProvider> location_{*this, "location", &Referee::on_location};
  Requires<localisation::OrientationProvider> compass_{*this, "compass", &Referee::on_compass};
};

std::string label(const Room& room) { return room.ref.empty() ? room.name : room.ref; }

}  // namespace

std::string Errand::text() const {
  return "seed " + std::to_string(seed) + ": " + label(*from) + " to " + label(*to) +
         (profile.stairs ? "" : ", no stairs") + (profile.lift ? "" : ", no lift") +
         (profile.outdoors ? "" : ", indoors") + ", level " + std::to_string(profile.access);
}

Errand draw_errand(const Building& building, std::uint64_t seed) {
  simulator::Random random(seed, simulator::hash("errand"));
  std::vector<const Room*> rooms;
  for (const Room& room : building.rooms()) {
    if (room.kind == building::RoomKind::Room && room.access < building::kClosed) rooms.push_back(&room);
  }
  for (;;) {
    Errand errand{seed, rooms[random.below(rooms.size())], rooms[random.below(rooms.size())], {}, 0.0};
    errand.profile = {.stairs = random.uniform() < 0.7,
                      .lift = random.uniform() < 0.7,
                      .outdoors = random.uniform() < 0.5,
                      .access = random.uniform() < 0.5 ? 0 : static_cast<int>(random.below(10))};
    if (errand.from->access > building::kOpen) continue;
    const auto route = building.route(*errand.from, *errand.to, errand.profile);
    if (!route || route->length_m < kShortest_m) continue;
    errand.route_s = route->cost_s;
    return errand;
  }
}

namespace {

void add_localisation(Stage& stage, const std::string& beacons, const Errand& errand) {
  stage.add<step_heading::StepHeading>("steps");
  stage.add<smart_bluetooth_localization::SmartBluetoothLocalization>("ble");
  stage.set("steps", "declination", 4);
  stage.set("ble", "beacons", beacons);
  stage.set("ble", "seed", static_cast<int>(errand.seed));
  stage.wire("steps.imu", "phone.imu");
  stage.wire("ble.beacons", "phone.beacons");
  stage.wire("ble.steps", "steps.steps");
  stage.wire("ble.orientation", "steps.orientation");
  stage.wire("ble.levels", "map.levels");
  stage.wire("ble.map_change", "map.map_change");
  stage.wire("referee.compass", "steps.orientation");
}

}  // namespace

Outcome lead(const Building& building, const std::string& file, const Errand& errand, Guidance guidance, Place place,
             const std::string& beacons) {
  Stage stage;
  stage.add<simulator::GuidedWalkSimulator>("phone");
  stage.add<map_server::MapServer>("map");
  stage.add<planning::SymbolicPlanner>("planner");
  stage.add<guidance::Navigation>("nav");
  Referee& referee = stage.add<Referee>("referee");
  referee.begin(building, errand, guidance, place);
  stage.set("phone", "building", file);
  stage.set("phone", "seed", static_cast<int>(errand.seed));
  stage.set("phone", "drawn_radio", true);
  stage.set("phone", "access", errand.profile.access);
  stage.set("phone", "start_room", label(*errand.from));
  stage.set("map", "building", file);
  if (place == Place::Beacons) add_localisation(stage, beacons, errand);
  const std::string located = place == Place::Beacons ? "ble.location"
                              : place == Place::Start ? "referee.start"
                                                      : "phone.truth";
  stage.wire("nav.location", located);
  stage.wire("nav.levels", "map.levels");
  stage.wire("nav.map_change", "map.map_change");
  stage.wire("nav.planner", "planner.plan");
  stage.wire("nav.profile", "referee.profile");
  stage.wire("referee.destination", "nav.destination");
  stage.wire("referee.path", "nav.path");
  stage.wire("referee.instructions", "nav.instructions");
  stage.wire("referee.truth", "phone.truth");
  stage.wire("referee.location", located);
  stage.wire("phone.instructions", "referee.passed_on");
  stage.start();
  stage.advance(1500ms);
  // One who is to be led by a localisation has stood for as long as it takes to open the page and pick a room.
  if (place == Place::Beacons) stage.advance(kPicksIn);
  const TimePoint begun = stage.now();
  referee.send();
  const double most_s = kAtLast * errand.route_s;
  while (!referee.ended() && to_seconds(stage.now() - begun) < most_s) {
    stage.advance(500ms);
    stage.advance(500ms);
    referee.judge();
  }
  Outcome outcome = referee.outcome;
  outcome.took_s = to_seconds(stage.now() - begun);
  if (outcome.ending.empty()) {
    outcome.arrived = referee.was_in_time();
    outcome.ending = outcome.arrived ? "never told to be there" : "not there in time";
  }
  for (const std::string& line : stage.log()) outcome.faults.push_back(line);
  return outcome;
}

}  // namespace fiona::walks
