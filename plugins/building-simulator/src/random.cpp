#include "fiona/simulator/random.hpp"

#include <cmath>
#include <numbers>

namespace fiona::simulator {

Random::Random(std::uint64_t seed, std::uint64_t stream) : increment_((stream << 1u) | 1u) {
  next();
  state_ += seed;
  next();
}

std::uint32_t Random::next() {
  const std::uint64_t old = state_;
  state_ = old * 6364136223846793005ull + increment_;
  const auto mixed = static_cast<std::uint32_t>(((old >> 18u) ^ old) >> 27u);
  const auto turn = static_cast<std::uint32_t>(old >> 59u);
  return (mixed >> turn) | (mixed << ((32u - turn) & 31u));
}

double Random::uniform() { return next() * 0x1p-32; }

double Random::uniform(double low, double high) { return low + (high - low) * uniform(); }

std::size_t Random::below(std::size_t count) {
  return static_cast<std::size_t>((static_cast<std::uint64_t>(next()) * count) >> 32u);
}

double Random::normal() {
  if (has_spare_) {
    has_spare_ = false;
    return spare_;
  }
  double u = 0.0, v = 0.0, square = 0.0;
  do {
    u = 2.0 * uniform() - 1.0;
    v = 2.0 * uniform() - 1.0;
    square = u * u + v * v;
  } while (square >= 1.0 || square == 0.0);
  const double scale = std::sqrt(-2.0 * std::log(square) / square);
  spare_ = v * scale;
  has_spare_ = true;
  return u * scale;
}

SpatialField::SpatialField(Random& random, double correlation_m) {
  constexpr int kWaves = 48;
  for (int i = 0; i < kWaves; ++i) {
    const double x = random.normal() / correlation_m;
    const double y = random.normal() / correlation_m;
    const double z = random.normal() / correlation_m;
    waves_.push_back({x, y, z, random.uniform(0.0, 2.0 * std::numbers::pi)});
  }
}

double SpatialField::at(double x_m, double y_m, double z_m) const {
  double sum = 0.0;
  for (const Wave& wave : waves_) sum += std::cos(wave.x * x_m + wave.y * y_m + wave.z * z_m + wave.phase);
  return sum * std::sqrt(2.0 / static_cast<double>(waves_.size()));
}

std::uint64_t hash(const char* text) {
  std::uint64_t value = 14695981039346656037ull;
  for (; *text != '\0'; ++text) value = (value ^ static_cast<unsigned char>(*text)) * 1099511628211ull;
  return value;
}

}  // namespace fiona::simulator
