#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <optional>

#include "error_statistics.hpp"
#include "fiona/time.hpp"

namespace fiona::recorder {

/// A place at a time. `level` is absent outdoors.
struct Fix {
  TimePoint time{};
  double x_m = 0.0;
  double y_m = 0.0;
  std::optional<double> level{};
};

/// The whole level nearest to z; halves go up.
int whole_level(double z);

/// Compares estimates with the truth at their own times, whichever of the two arrives first. The truth is
/// taken as straight between two of its fixes.
class TruthComparison {
 public:
  /// An estimate between two truths that are further apart is not compared.
  static constexpr Duration kLongestGap = std::chrono::seconds(2);
  /// Fixes of each side that wait for the other; the oldest go.
  static constexpr std::size_t kMostWaiting = 256;

  void add_estimate(const Fix& estimate);
  void add_truth(const Fix& truth);

  /// Horizontal errors of all that could be compared.
  const ErrorStatistics& errors() const { return errors_; }
  std::uint64_t right_levels() const { return right_levels_; }
  /// Horizontal error of the latest estimate that could be compared.
  std::optional<double> latest_m() const { return latest_m_; }

 private:
  void compare_waiting();
  void compare(const Fix& estimate);

  std::deque<Fix> truths_{};  ///< ascending in time
  std::deque<Fix> waiting_{};
  ErrorStatistics errors_{};
  std::uint64_t right_levels_ = 0;
  std::optional<double> latest_m_{};
};

}  // namespace fiona::recorder
