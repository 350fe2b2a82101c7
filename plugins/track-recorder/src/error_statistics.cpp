#include "error_statistics.hpp"

#include <algorithm>
#include <cmath>

namespace fiona::recorder {

void ErrorStatistics::add(double error_m) {
  ++count_;
  sum_m_ += error_m;
  largest_m_ = std::max(largest_m_, error_m);
  if (error_m >= kLargest_m) return;
  const auto bin = static_cast<std::size_t>(std::llround(error_m / kBin_m));
  if (bin >= bins_.size()) bins_.resize(bin + 1);
  ++bins_[bin];
}

double ErrorStatistics::mean_m() const { return count_ == 0 ? 0.0 : sum_m_ / static_cast<double>(count_); }

double ErrorStatistics::quantile_m(double share) const {
  const auto wanted = static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(count_)));
  std::uint64_t passed = 0;
  for (std::size_t bin = 0; bin < bins_.size(); ++bin) {
    passed += bins_[bin];
    if (bins_[bin] > 0 && passed >= wanted) return static_cast<double>(bin) * kBin_m;
  }
  return largest_m_;
}

}  // namespace fiona::recorder
