#pragma once

#include <chrono>
#include <optional>

#include <fiona/time.hpp>

#include "situation.hpp"

namespace fiona::guidance {

/// What a walker is told of: how to begin, to come to the path, to turn along it or to go back a little; what is ahead,
/// by how near it is; that they are there.
enum class Phase { Start, Align, Join, Back, Ahead, Announced, Now, Near, Arrived };

/// What an instruction's number stands for: while it holds, only distance and hour change.
struct Word {
  Phase phase = Phase::Ahead;
  std::size_t maneuver = 0;
  int repeated = 0;
  bool operator==(const Word&) const = default;
};

/// What a walker has been told, and whether they do it.
class Told {
 public:
  static constexpr Duration kDoes = std::chrono::seconds(4);  ///< so long it takes to do what was told

  /// Notes how near they come to what they are to do.
  void follow(const Situation& here);
  /// Notes what they are told, whether it is new or goes on.
  void note(const Word& word, const Situation& here);

  const std::optional<Word>& last() const { return last_; }
  bool was(Phase phase) const { return last_ && last_->phase == phase; }
  /// When the last one was new.
  TimePoint since() const { return since_; }
  /// To the path, just now.
  bool has_led_back(TimePoint now) const;
  /// The next maneuver is what they are to do now.
  bool to_do_next(const Situation& here) const { return to_do_ && to_do_->maneuver == here.next; }
  /// They have just been told so, and have not begun yet.
  bool reacts(const Situation& here) const;
  bool is_doing(const Situation& here) const;
  /// Who was told to go through a door or to take stairs, and gets away from there otherwise than those lead.
  bool has_missed(const Situation& here) const;
  /// They do not do what was told last: it is to be told again.
  bool is_overdue(const Situation& here) const;

 private:
  bool has_turned(const Walker& walker) const;

  std::optional<Word> last_{};
  TimePoint since_{};
  std::optional<double> looked_rad_{};  ///< where the walker looked then
  std::optional<TimePoint> led_back_at_{};
  struct ToDo {
    std::size_t maneuver = 0;
    TimePoint at{};
    double least_m = 0.0;  ///< since then, from where it is to be done
  };
  std::optional<ToDo> to_do_{};
};

}  // namespace fiona::guidance
