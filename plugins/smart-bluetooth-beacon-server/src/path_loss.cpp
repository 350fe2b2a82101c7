#include "path_loss.hpp"

#include <algorithm>
#include <cmath>

#include "fiona/error.hpp"

namespace fiona::beacon_server {

Distance distance_of(double measured_power_dbm, double rssi_dbm, const PathLoss& loss) {
  const double decades = (measured_power_dbm - rssi_dbm) / (10.0 * loss.exponent);
  // Beyond 10 km nobody hears a beacon: a payload that claims more power than it has.
  return {std::pow(10.0, std::clamp(decades, -3.0, 4.0)), std::pow(10.0, loss.spread_db / (10.0 * loss.exponent))};
}

PathLoss fit(std::span<const std::pair<double, double>> pairs) {
  double squares = 0.0, cross = 0.0;
  for (const auto& [metres, loss_db] : pairs) {
    const double x = 10.0 * std::log10(metres);
    squares += x * x;
    cross += x * loss_db;
  }
  if (pairs.size() < 3 || !(squares > 0.0) || !std::isfinite(squares) || !std::isfinite(cross)) {
    throw Error(ErrorCode::Usage, {.what = "no path loss can be fitted to these readings",
                                   .expected = "three or more, at distances above 0 that are not all 1 m",
                                   .found = std::to_string(pairs.size())});
  }
  PathLoss result{cross / squares, 0.0};
  double residuals = 0.0;
  for (const auto& [metres, loss_db] : pairs) {
    const double off = loss_db - result.exponent * 10.0 * std::log10(metres);
    residuals += off * off;
  }
  result.spread_db = std::sqrt(residuals / static_cast<double>(pairs.size() - 1));
  return result;
}

}  // namespace fiona::beacon_server
