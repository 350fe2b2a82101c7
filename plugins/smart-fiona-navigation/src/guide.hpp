#pragma once

#include <optional>
#include <string>
#include <vector>

#include <fiona/hmi.pb.h>
#include <fiona/time.hpp>

#include "level_plan.hpp"
#include "maneuvers.hpp"
#include "path_tracker.hpp"
#include "progress.hpp"
#include "situation.hpp"
#include "told.hpp"

namespace fiona::guidance {

/// Leads a walker along a path. A turn is announced 6 m before it and again at 2 m, hours are those on a clock face in
/// front of the walker, and a walker who looks elsewhere is turned to the path first. No direction that it gives leads
/// through a wall.
///
/// Its parts remember one thing each: where the walker is (PathTracker), what there is to do next (Progress), and what
/// they were told and make of it (Told). Which word that calls for is decided here.
class Guide {
 public:
  /// `plan` must outlive it. `first`: the walk begins, and is told as such. `leaves`: since when the walker has been
  /// told to leave the room, and does.
  Guide(const LevelPlan& plan, building::Route route, std::string destination, bool first, TimePoint now,
        std::optional<TimePoint> leaves = std::nullopt);

  struct Advice {
    hmi::Instruction instruction{};  ///< without number
    bool is_new = false;             ///< another instruction than the one before, to be numbered
    hmi::NextTurn turn{};
    bool off_path = false;  ///< for some time, or surely: another path is needed
    bool arrived = false;
  };
  Advice follow(const Walker& walker, TimePoint now);

  const Path& path() const { return path_; }

 private:
  Word choose(Situation& here, bool arrived);
  Phase phase_of(const Situation& here);
  bool starts(const Situation& here) const;
  bool is_aligned(const Situation& here, double rest_rad);
  bool joins(const Situation& here, double rest_rad) const;
  Phase nearness(const Situation& here);
  building::Point aim(const Situation& here) const;
  building::Point ahead(const Situation& here) const;
  hmi::NextTurn::TypeOfTurn hour(Phase phase, const Situation& here) const;
  hmi::NextTurn::TypeOfTurn hour_ahead(Phase phase, const Situation& here) const;
  hmi::Instruction instruction(Phase phase, const Situation& here) const;
  hmi::NextTurn turn(Phase phase, const hmi::Instruction& told, const Situation& here) const;
  std::string words(Phase phase, const hmi::Instruction& told, const Situation& here) const;
  std::string whole_way() const;

  const LevelPlan& plan_;
  const Path path_;
  const std::vector<Maneuver> maneuvers_;
  const std::string destination_;
  const bool first_;
  const TimePoint begun_;
  const std::optional<TimePoint> leaves_until_;  ///< the door of the first room is not told of before

  PathTracker tracker_;
  Progress progress_;
  Told told_;
  std::string words_;  ///< of the newest word
  struct Alignment {
    bool holds = true;
    std::optional<TimePoint> astray_since{};
  } alignment_{};  ///< with the way to walk
  struct Nearness {
    std::size_t maneuver = 0;
    Phase told = Phase::Ahead;
  } nearness_{};  ///< of a maneuver, as it was told last
  struct Back {
    double heading_rad = 0.0;
    TimePoint since{};
  };
  std::optional<Back> back_{};
};

}  // namespace fiona::guidance
