#pragma once

#include <optional>

#include <fiona/time.hpp>

#include "situation.hpp"
#include "told.hpp"

namespace fiona::guidance {

/// Which maneuver is to be done next: those before it are behind the walker.
class Progress {
 public:
  explicit Progress(std::size_t next) : next_(next) {}
  std::size_t next() const { return next_; }
  void follow(Situation& here, const Told& told);
  /// Who does not get on behind a door has not come through it. False: there is none.
  bool return_to_door(Situation& here);
  /// The next one is a door that the walker has seemed to be behind.
  bool is_shut(const Situation& here) const { return shut_ && shut_->door == here.next; }

 private:
  void go_back(Situation& here);
  bool has_passed(const Situation& here, const Told& told) const;
  bool is_through(const Situation& here, const Told& told) const;

  std::size_t next_;
  TimePoint passed_at_{};  ///< when another one became the next
  struct Shut {
    std::size_t door = 0;
    building::Point seen_at{};  ///< where the walker seemed to be when that was found
    TimePoint since{};
  };
  std::optional<Shut> shut_{};
};

}  // namespace fiona::guidance
