#pragma once

#include <cstdint>
#include <vector>

namespace fiona::recorder {

/// Mean and quantiles of position errors in bounded memory: errors are counted to the nearest centimetre.
class ErrorStatistics {
 public:
  static constexpr double kBin_m = 0.01;
  static constexpr double kLargest_m = 500.0;  ///< beyond it a quantile is the largest error seen

  void add(double error_m);
  std::uint64_t count() const { return count_; }
  /// 0 while nothing was added.
  double mean_m() const;
  /// The error that a share of all do not exceed, to half a centimetre; 0 while nothing was added.
  double quantile_m(double share) const;

 private:
  std::vector<std::uint64_t> bins_{};
  std::uint64_t count_ = 0;
  double sum_m_ = 0.0;
  double largest_m_ = 0.0;
};

}  // namespace fiona::recorder
