#pragma once

#include <optional>
#include <string>
#include <vector>

#include <fiona/hmi.pb.h>

#include "measured_path.hpp"

namespace fiona::walks {

/// How somebody who walked up to a mark was told of it.
struct Announcement {
  Mark mark{};
  std::optional<double> first_m{}, again_m{};              ///< before it, as the first and the second word of it said
  std::optional<double> truly_first_m{}, truly_again_m{};  ///< by where they were then
  bool held_up = false;                                    ///< on the leg to it they were turned to the path

  /// What is wrong with it; empty: nothing. Announced at 6 m, give or take 2 m, and told again at 2 m, give or take 1
  /// m.
  std::string fault() const;
};

/// Listens to what is said on one path, and to how far along it the walker gets.
class Announcements {
 public:
  /// A leg that is shorter has no room for two words.
  static constexpr double kLeg_m = 9.0;

  explicit Announcements(const std::vector<Mark>& marks);
  void walk(double truly_m);
  void hear(const hmi::Instruction& said, double believed_m, double truly_m);
  /// The marks that were walked up to and passed, each once.
  std::vector<Announcement> take_passed();

 private:
  struct Ahead {
    Announcement told{};
    bool walked_up_to = false;  ///< from so far before it that two words have room
    bool passed = false;
  };
  std::vector<Ahead> ahead_{};
};

}  // namespace fiona::walks
