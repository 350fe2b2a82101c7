#pragma once

#include <optional>
#include <span>
#include <utility>

namespace fiona::beacon_server {

/// Log-distance path loss: a beacon is heard at `measured power + gain - 10 exponent log10(distance)`, give or take
/// `spread`.
struct PathLoss {
  double exponent;
  double spread_db;      ///< standard deviation
  double gain_db = 0.0;  ///< of the receiver: what it hears beyond the measured power, 1 m away
};

/// As often too long as too short.
double distance_m(double measured_power_dbm, double rssi_dbm, const PathLoss& loss);

/// How good a distance is: 68 % of the truths lie between the distance divided by this and times it, and 95 % within
/// its square.
double distance_factor(const PathLoss& loss);

/// Least squares over what one receiver heard: pairs of distance in metres and reading below the measured power in dB.
/// Nothing of less than three, of distances that are all the same, or of one that is not above 0.
std::optional<PathLoss> fit(std::span<const std::pair<double, double>> metres_and_loss_db);

}  // namespace fiona::beacon_server
