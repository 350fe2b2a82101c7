#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "fiona/component.hpp"
#include "fiona/hmi.fiona.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/smart_fiona_navigation/params.pb.h"
#include "guide.hpp"
#include "landmarks.hpp"
#include "level_plan.hpp"
#include "shown_position.hpp"
#include "task_graph.hpp"

namespace fiona::guidance {

/// Leads a person to a destination: asks for the map, for the person's profile and for a plan, and gives instructions
/// on the way until the person is there. What it cannot do it says, to the person, as an instruction.
class Navigation final : public Component {
 public:
  using Component::Component;

 private:
  using Parameters = smart_fiona_navigation::Parameters;

  /// Never changed but for what the task graph finds out. Shared, because guidance goes on by one while the next is
  /// planned for.
  struct Map {
    explicit Map(LevelPlan read) : plan(std::move(read)) {}
    const LevelPlan plan;
    std::unique_ptr<TaskGraph> tasks;
  };
  struct Trip {
    std::uint64_t number = 0;
    navigation::CommDestination wish{};
    building::PathPoint goal{};               ///< on the map that was planned on last
    bool begun = false;                       ///< there was a path
    std::optional<TimePoint> sought_since{};  ///< it was not sure enough where the person is
  };
  /// A sentence for the person, and when to try again; not: never, unless something changes.
  struct Refusal {
    std::string text;
    std::optional<Duration> again;
    hmi::Instruction::Kind kind = hmi::Instruction::NO_PATH;
  };

  void on_mode(std::string_view mode) override;
  void on_destination(const navigation::CommDestination& wish);
  void on_location(const Received<localisation::CommLocation>& location);
  void on_map_change(const Fired<navigation::LevelMapVersion>& change);

  void tell();
  Async<> work();
  Async<> watch_map();
  Async<> fetch_map();
  double declination() const;
  void move_to_map(localisation::CommPosition& position);
  void ask_for(const std::string& user_name, const std::string& session);
  Async<> ask_profile();
  void take_profile(const hmi::CommUserProfileReply& profile);
  void forget_user();
  bool is_sought();
  building::PathPoint goal();
  Async<> plan();
  Async<std::optional<Refusal>> find_path(building::PathPoint from);
  std::optional<Refusal> check(const Trip& trip) const;
  std::optional<building::PathPoint> start();
  Refusal no_way(const Map& map, const building::PathPoint& from) const;
  std::string goal_name() const;
  /// Another destination may have come while something was asked for.
  bool is_trip(std::uint64_t number) const { return trip_ && trip_->number == number; }
  bool is_due(const std::optional<TimePoint>& at) const { return at && now() >= *at; }

  bool knows_level(localisation::CommPosition& position);
  void note_heading(const localisation::CommLocation& location, bool leaps);
  void lead();
  void tell_passed_points();
  void say_again();
  void watch_location();
  void begin_guidance(std::shared_ptr<Map> map, building::Route route);
  void end_guidance();
  void say(hmi::Instruction instruction, bool is_new);
  void say(hmi::Instruction::Kind kind, const std::string& text);
  void show_again();
  void put_shown(localisation::CommLocation told, const ShownPosition::Shown& shown, TimePoint origin);
  void put_path(const building::Route* route);

  Params<Parameters> params_{*this};
  Provides<navigation::DestinationProvider> destination_{
      *this, "destination", &Navigation::on_destination, {.doc = "where to go; a new one replaces the one before"}};
  Provides<navigation::PathProvider> path_{*this, "path", {.doc = "the way that is led along"}};
  Provides<hmi::InstructionProvider> instructions_{*this, "instructions", {.doc = "what the person is to do next"}};
  Provides<hmi::LocalPath> turn_{*this, "turn", {.doc = "the next turn: how far, and which hour on a clock face"}};
  Provides<localisation::LocationProvider> shown_{
      *this, "shown", {.doc = "the location to be shown: jumps are blended, and the covariance covers both"}};
  Requires<localisation::LocationProvider> location_{
      *this, "location", &Navigation::on_location, {.doc = "where the person is", .delivery = Delivery::Newest}};
  Requires<navigation::LevelMap> levels_{*this, "levels", {.doc = "the building"}};
  Requires<navigation::LevelMapChange> change_{
      *this, "map_change", &Navigation::on_map_change, {.optional = true, .doc = "that the building has changed"}};
  Requires<navigation::PlanProvider> planner_{*this, "planner", {.doc = "the planner of tasks"}};
  Requires<hmi::ProfileProvider> profile_{
      *this,
      "profile",
      {.optional = true, .doc = "what the person may use; without it everyone is a guest with both legs"}};
  Probe<std::int64_t> plans_{*this, "plans", {.doc = "ways found so far"}};
  Probe<std::int64_t> reroutes_{*this, "reroutes", {.doc = "how often the person has left the path"}};
  Probe<double> planned_in_{*this, "planned_in", {.unit = "ms", .doc = "time of computation of the newest plan"}};
  Task tell_{*this, "tell", std::chrono::milliseconds(100), &Navigation::tell};
  Task work_{*this, "work", std::chrono::milliseconds(100), &Navigation::work};
  Task watch_{*this, "watch", std::chrono::seconds(1), &Navigation::watch_map};

  // what is known
  std::shared_ptr<Map> map_;
  std::string map_fault_;
  double declination_rad_ = 0.0;  ///< at the map's place
  std::optional<TimePoint> map_due_at_{TimePoint{}};
  bool watches_ = false;
  bool told_of_frame_ = false;  ///< that places are told in another one: once
  // who the person is
  hmi::CommUserProfileRequest user_;
  std::optional<TimePoint> profile_due_at_;  ///< none: there is nobody to ask for
  bool has_profile_ = false;
  std::string profile_fault_;
  building::RouteOptions options_{};
  bool refused_point_ = false;  ///< of the profile: told once
  Passing passing_;
  // where the person is
  ShownPosition blender_;
  std::optional<Walker> walker_;
  TimePoint located_{};
  std::optional<localisation::CommLocation> last_shown_;
  TimePoint shown_at_{};
  std::optional<TimePoint> level_told_{};
  bool told_of_level_ = false;
  TimePoint shown_origin_{};  ///< of what is shown
  bool uncertain_ = false;
  std::optional<std::pair<building::Point, TimePoint>> course_from_;
  std::optional<double> course_rad_;
  std::optional<TimePoint> between_levels_;
  // where the person is led
  std::optional<Trip> trip_;
  std::uint64_t trips_ = 0;
  std::optional<TimePoint> plan_due_at_;
  std::shared_ptr<Map> led_by_;  ///< the map that the guide refers to
  std::optional<Guide> guide_;
  hmi::Instruction said_;
  std::uint32_t number_ = 0;
  bool other_said_ = false;  ///< the guide's instruction is to be said again, with a number
  bool attends_ = false;     ///< a point of attention was told last
  std::int64_t plans_count_ = 0;
  std::int64_t reroutes_count_ = 0;
};

}  // namespace fiona::guidance
