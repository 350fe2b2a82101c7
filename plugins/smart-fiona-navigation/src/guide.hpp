#pragma once

#include <optional>
#include <string>
#include <vector>

#include <fiona/hmi.pb.h>
#include <fiona/time.hpp>

#include "level_plan.hpp"
#include "maneuvers.hpp"

namespace fiona::guidance {

struct Walker {
  building::PathPoint place{};
  std::optional<double> heading_rad{};  ///< clockwise from true north
  double sigma_m = 0.0;                 ///< of the place, along its longer axis
};

/// Leads a walker along a path. A turn is announced 6 m before it and again at 2 m, hours are those on a clock face in
/// front of the walker, and a walker who looks elsewhere is turned to the path first. No direction that it gives leads
/// through a wall.
class Guide {
 public:
  static constexpr double kAnnounced_m = 6.0;
  static constexpr double kNow_m = 2.0;

  /// `plan` must outlive it. `first`: the walk begins, and is told as such. `leaves`: since when the walker has been
  /// told to leave the room, and does.
  Guide(const LevelPlan& plan, building::Route route, std::string destination, bool first, TimePoint now,
        std::optional<TimePoint> leaves = std::nullopt);

  struct Advice {
    hmi::Instruction instruction{};  ///< without number
    bool is_new = false;             ///< another instruction than the one before, to be numbered
    hmi::NextTurn turn{};
    bool off_path = false;  ///< for some time: another path is needed
    bool arrived = false;
  };
  Advice follow(const Walker& walker, TimePoint now);

  const Path& path() const { return path_; }
  /// Where on the path the walker is.
  double at_m() const { return at_m_; }

 private:
  enum class Phase { Start, Align, Join, Back, Ahead, Announced, Now, Arrived };
  struct Key {
    Phase phase = Phase::Ahead;
    std::size_t maneuver = 0;
    int repeated = 0;
    bool operator==(const Key&) const = default;
  };

  void locate(const Walker& walker, TimePoint now);
  double steadied(double at_m, const Walker& walker, TimePoint now);
  bool begins_in_room() const;
  bool is_at_lift() const;
  double least_m(const Walker& walker) const;
  bool return_to_door(const Walker& walker, TimePoint now);
  void pass(const Walker& walker, TimePoint now);
  void note_motion(const Walker& walker, TimePoint now);
  bool gets_nowhere(TimePoint now);
  bool stands(const Walker& walker, TimePoint now) const;
  building::Point spot() const;
  bool has_missed(const Walker& walker, TimePoint now) const;
  bool has_passed(const Maneuver& maneuver, const Walker& walker, TimePoint now) const;
  bool is_close_to_other_level() const;
  bool is_before(const Maneuver& door, const Walker& walker) const;
  bool is_at_door(const Walker& walker) const;
  bool turns(const Walker& walker) const;
  bool is_doing(const Walker& walker, TimePoint now) const;
  bool is_overdue(const Key& key, const Walker& walker, TimePoint now) const;
  bool arrived(const Walker& walker) const;
  Phase phase_of(const Walker& walker, TimePoint now);
  bool joins(const Walker& walker, double rest_rad, TimePoint now) const;
  Phase nearness(const Walker& walker);
  building::Point aim(const Walker& walker) const;
  std::optional<double> turn_to(building::Point direction, const Walker& walker) const;
  hmi::NextTurn::TypeOfTurn hour(Phase phase, const Walker& walker) const;
  bool is_before_turn(Phase phase) const;
  bool walks_along(building::Point along, const Walker& walker) const;
  bool is_as_told(Phase phase, double rest_rad, const Walker& walker) const;
  std::optional<double> then() const;
  void fill(Advice& advice, const Key& key, const Walker& walker);
  std::string words(const Key& key, const hmi::Instruction& instruction, const Walker& walker) const;
  const Maneuver& next() const { return maneuvers_[next_]; }
  double to_next_m() const { return std::max(0.0, next().at_m - at_m_); }

  const LevelPlan& plan_;
  const Path path_;
  const std::vector<Maneuver> maneuvers_;
  const std::string destination_;
  const bool first_;
  const TimePoint begun_;
  std::optional<TimePoint> leaves_until_{};  ///< the door of the first room is not told of before

  double at_m_ = 0.0;
  double off_m_ = 0.0;
  bool on_other_level_ = false;
  std::optional<TimePoint> located_{};
  std::size_t next_ = 0;
  TimePoint passed_at_{};
  struct Shut {
    std::size_t maneuver;
    building::Point seen_at;  ///< where the walker seemed to be when that was found
    TimePoint since;
  };
  std::optional<Shut> shut_{};  ///< a door that the walker stood before: passed only once it is behind
  struct Told {
    std::size_t maneuver;
    TimePoint at;
    double least_m;  ///< since then, from where it is to be done
  };
  std::optional<Told> told_{};  ///< what was to be done now, and since when
  struct Back {
    double heading_rad;
    TimePoint since;
  };
  std::optional<Back> back_{};  ///< who does not get on is sent back a little: on the move they are found better
  bool aligned_ = true;
  TimePoint new_since_{};               ///< when the newest word was new
  std::optional<double> looked_rad_{};  ///< where the walker looked then
  std::optional<TimePoint> astray_since_{};
  std::optional<TimePoint> led_back_at_{};                  ///< when they were told last how to come back to the path
  std::pair<std::size_t, Phase> nearest_{0, Phase::Ahead};  ///< of a maneuver, what has been said of how near it is
  std::optional<TimePoint> wrong_since_;
  std::optional<Key> said_;
  std::string words_;
  double got_to_m_ = 0.0;
  TimePoint got_to_at_{};  ///< that place of the path, or one about it
  building::Point moved_from_{};
  TimePoint moved_at_{};
};

}  // namespace fiona::guidance
