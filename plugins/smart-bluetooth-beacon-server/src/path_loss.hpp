#pragma once

#include <span>
#include <utility>

namespace fiona::beacon_server {

/// Log-distance path loss: a beacon is heard at `measured power - 10 exponent log10(distance)`, give or take `spread`.
struct PathLoss {
  double exponent = 2.9;
  double spread_db = 5.5;
};

/// A distance that is as often too long as too short, and the factor to either side that holds 68 % of the truths.
struct Distance {
  double metres;
  double factor;
};

Distance distance_of(double measured_power_dbm, double rssi_dbm, const PathLoss& loss);

/// Least squares over pairs of distance in metres (above 0) and reading below the measured power in dB; the power stays
/// as the beacons say it. Throws fiona::Error with less than three pairs, or if they are all 1 m apart.
PathLoss fit(std::span<const std::pair<double, double>> metres_and_loss_db);

}  // namespace fiona::beacon_server
