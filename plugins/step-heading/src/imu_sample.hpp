#pragma once

#include <chrono>

#include <Eigen/Core>

namespace fiona::steps {

/// One GetIMU object. Phone axes: x right, y up the screen, z out of the screen.
struct ImuSample {
  std::chrono::milliseconds time;
  Eigen::Vector3d acceleration_g;  ///< specific force: a phone at rest on a table reads (0, 0, 1)
  Eigen::Vector3d rate_dps;
  Eigen::Vector3d field_gauss;  ///< hard iron removed, as phones deliver it
};

}  // namespace fiona::steps
