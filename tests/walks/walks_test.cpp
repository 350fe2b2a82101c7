// The closed loop: people who know nothing of the building are led to rooms of it. FIONA_WALKS=N: so many walks;
// FIONA_SEED=N: the first one's seed.
#include <cstdio>
#include <cstdlib>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "guided_walk.hpp"

namespace fiona::walks {
namespace {

using building::Building;

std::uint64_t number(const char* variable, std::uint64_t otherwise) {
  const char* text = std::getenv(variable);
  return text ? std::strtoull(text, nullptr, 10) : otherwise;
}

struct Tally {
  int walks = 0;
  int arrived = 0;
  int faults = 0;
  int reroutes = 0;
  double time = 0.0;  ///< taken, as a share of the route's
  double share() const { return static_cast<double>(arrived) / walks; }
};

Tally walk(std::uint64_t count, Guidance guidance) {
  const std::string file = FIONA_INSTITUTE_FILE;
  const Building building = Building::read(file);
  const std::uint64_t first = number("FIONA_SEED", 1);
  Tally tally;
  for (std::uint64_t seed = first; seed < first + count; ++seed) {
    const Errand errand = draw_errand(building, seed);
    const Outcome outcome = lead(building, file, errand, guidance);
    ++tally.walks;
    tally.arrived += outcome.arrived ? 1 : 0;
    tally.reroutes += outcome.reroutes;
    tally.time += outcome.took_s / errand.route_s;
    tally.faults += static_cast<int>(outcome.faults.size());
    if (guidance == Guidance::Whole && (!outcome.arrived || !outcome.faults.empty())) {
      std::printf("%s: %s after %.0f s of %.0f s\n", errand.text().c_str(), outcome.ending.c_str(), outcome.took_s,
                  errand.route_s);
      for (const std::string& fault : outcome.faults) std::printf("  %s\n", fault.c_str());
    }
  }
  std::printf("seeds %llu to %llu: %d of %d arrived, %.2f times the route's time, %d times rerouted, %d faults\n",
              static_cast<unsigned long long>(first), static_cast<unsigned long long>(first + count - 1), tally.arrived,
              tally.walks, tally.time / tally.walks, tally.reroutes, tally.faults);
  return tally;
}

TEST(Walks, PeopleAreLedToTheirRooms) {
  const Tally tally = walk(number("FIONA_WALKS", 8), Guidance::Whole);
  EXPECT_GE(tally.share(), 0.99);
  EXPECT_EQ(tally.faults, 0);
}

TEST(Walks, WithGuidanceMutedNextToNobodyArrives) {
  const Tally tally = walk(number("FIONA_WALKS", 8), Guidance::Muted);
  EXPECT_LT(tally.share(), 0.05);
}

TEST(Walks, TheSameSeedIsTheSameWalk) {
  const std::string file = FIONA_INSTITUTE_FILE;
  const Building building = Building::read(file);
  const Errand errand = draw_errand(building, 3);
  const Outcome once = lead(building, file, errand, Guidance::Whole);
  const Outcome again = lead(building, file, errand, Guidance::Whole);
  EXPECT_EQ(once.instructions, again.instructions);
  EXPECT_EQ(once.took_s, again.took_s);
  const Outcome other = lead(building, file, draw_errand(building, 4), Guidance::Whole);
  EXPECT_NE(once.instructions, other.instructions);
}

}  // namespace
}  // namespace fiona::walks
