#pragma once

#include <cstdint>
#include <vector>

namespace fiona::simulator {

/// PCG32 (O'Neill, "PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms", 2014) with
/// normal variates by Marsaglia's polar method. The variates of the standard library differ between its
/// versions; these give the same run for the same seed wherever doubles and libm are the same.
class Random {
 public:
  /// Different streams of one seed are independent: one for each model, so that a change in one leaves the
  /// others.
  explicit Random(std::uint64_t seed, std::uint64_t stream = 0);

  std::uint32_t next();
  double uniform();  ///< [0, 1)
  double uniform(double low, double high);
  std::size_t below(std::size_t count);  ///< 0 .. count - 1; count must not be 0
  double normal();                       ///< mean 0, standard deviation 1

 private:
  std::uint64_t state_ = 0;
  std::uint64_t increment_;
  double spare_ = 0.0;
  bool has_spare_ = false;
};

/// A random value for every place: normal with standard deviation 1, smooth over `correlation_m`, the same
/// whenever the same place is visited. By random Fourier features (Rahimi and Recht, 2007) of a Gaussian
/// covariance.
class SpatialField {
 public:
  SpatialField(Random& random, double correlation_m);

  double at(double x_m, double y_m, double z_m) const;

 private:
  struct Wave {
    double x, y, z, phase;
  };
  std::vector<Wave> waves_{};
};

/// FNV-1a: a stream of its own for each name.
std::uint64_t hash(const char* text);

}  // namespace fiona::simulator
