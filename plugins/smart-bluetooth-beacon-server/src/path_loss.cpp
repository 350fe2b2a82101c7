#include "path_loss.hpp"

#include <algorithm>
#include <cmath>

namespace fiona::beacon_server {
namespace {

constexpr double kSameDistance_db2 = 1e-6;  // variance that is left by rounding

}  // namespace

double distance_m(double measured_power_dbm, double rssi_dbm, const PathLoss& loss) {
  const double decades = (measured_power_dbm + loss.gain_db - rssi_dbm) / (10.0 * loss.exponent);
  // Beyond 10 km nobody hears a beacon: a payload that claims more power than it has.
  return std::pow(10.0, std::clamp(decades, -3.0, 4.0));
}

double distance_factor(const PathLoss& loss) { return std::pow(10.0, loss.spread_db / (10.0 * loss.exponent)); }

std::optional<PathLoss> fit(std::span<const std::pair<double, double>> pairs) {
  if (pairs.size() < 3) return std::nullopt;
  const auto count = static_cast<double>(pairs.size());
  double mean_x = 0.0, mean_loss = 0.0;
  for (const auto& [metres, loss_db] : pairs) {
    mean_x += 10.0 * std::log10(metres) / count;
    mean_loss += loss_db / count;
  }
  double squares = 0.0, cross = 0.0, losses = 0.0;
  for (const auto& [metres, loss_db] : pairs) {
    const double x = 10.0 * std::log10(metres) - mean_x, loss = loss_db - mean_loss;
    squares += x * x;
    cross += x * loss;
    losses += loss * loss;
  }
  if (!(squares > kSameDistance_db2 * count) || !std::isfinite(squares) || !std::isfinite(cross)) return std::nullopt;
  const double exponent = cross / squares;
  return PathLoss{exponent, std::sqrt(std::max(0.0, losses - exponent * cross) / (count - 2.0)),
                  exponent * mean_x - mean_loss};
}

}  // namespace fiona::beacon_server
