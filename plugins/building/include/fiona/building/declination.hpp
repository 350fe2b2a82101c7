#pragma once

#include <chrono>

namespace fiona::building {

/// The bearing of magnetic north at a place of the WGS84 ellipsoid, in radians clockwise from true north. `since_1970` is the
/// date, as a component's clock tells it; before 2025 and after 2029, which the model is not made for, it answers for the nearer end.
/// Good to half a degree (root mean square, away from the magnetic poles), without what a building's own steel adds.
/// Source: World Magnetic Model 2025, NOAA National Centers for Environmental Information and British Geological Survey,
/// epoch 2025.0 to 2030.0.
double declination_rad(double latitude_deg, double longitude_deg, std::chrono::milliseconds since_1970);

}  // namespace fiona::building
