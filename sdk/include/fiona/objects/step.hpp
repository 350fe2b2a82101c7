#pragma once

#include <cmath>

#include "fiona/localisation.pb.h"

/// How exact a `fiona.localisation.CommStep` is. A variance that is absent is not known, which is not zero.
namespace fiona::localisation {

/// Standard deviation of the length, in metres; of a step that does not tell, a fifth of its length. [any thread]
inline double length_sd_m(const CommStep& step) {
  return step.has_length_var() ? std::sqrt(step.length_var()) : 0.2 * step.length();
}

/// Standard deviation of the heading, in radians; of a step that does not tell 0.3, what a compass beside steel may err by.
/// [any thread]
inline double heading_sd_rad(const CommStep& step) {
  return step.has_heading_var() ? std::sqrt(step.heading_var()) : 0.3;
}

}  // namespace fiona::localisation
