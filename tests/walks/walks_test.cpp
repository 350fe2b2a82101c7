// The closed loop: people who know nothing of the building are led to rooms of it. FIONA_WALKS=N: so many walks;
// FIONA_SEED=N: the first one's seed; FIONA_COURSE=1: prints their courses;
// FIONA_MAPS=DIR: keeps the surveys' beacon maps there, by seed, and takes those that are there; FIONA_ERRANDS=N: leads
// by them people with the errands of the seeds N later.
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <numeric>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "guided_walk.hpp"
#include "surveyor.hpp"

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
  int told_so = 0;
  int faults = 0, untimely = 0;
  int reroutes = 0;
  double time = 0.0;              ///< taken until told to be there, in all, as a share of the routes'
  std::vector<double> to_door{};  ///< the same until at the door, of each who came there
  std::vector<double> errors_m{};
  int inside = 0, wrong_level = 0, unplaced = 0;  ///< seconds
  std::vector<Announcement> announcements{};
  double share() const { return static_cast<double>(arrived) / walks; }
};

double percentile(std::vector<double> values, double share) {
  if (values.empty()) return NAN;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

double mean(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

void print_distances(const char* what, const std::vector<std::optional<double>>& told) {
  std::vector<double> distances;
  for (const auto& one : told) {
    if (one) distances.push_back(*one);
  }
  std::printf("    %-22s %3zu of %3zu", what, distances.size(), told.size());
  if (!distances.empty()) {
    std::printf(", %5.2f to %5.2f m (p5 %.2f, median %.2f, p95 %.2f)", percentile(distances, 0.0),
                percentile(distances, 1.0), percentile(distances, 0.05), percentile(distances, 0.5),
                percentile(distances, 0.95));
  }
  std::printf("\n");
}

/// By what guidance said, and by where they were.
void print_announcements(const std::vector<Announcement>& all) {
  for (const auto& [kind, name] : {std::pair(Mark::Kind::Turn, "turns"), std::pair(Mark::Kind::Door, "doors"),
                                   std::pair(Mark::Kind::Climb, "stairs and lifts")}) {
    std::vector<std::optional<double>> first, again, truly_first, truly_again;
    for (const Announcement& one : all) {
      if (one.mark.kind != kind || one.held_up) continue;
      first.push_back(one.first_m);
      again.push_back(one.again_m);
      truly_first.push_back(one.truly_first_m);
      truly_again.push_back(one.truly_again_m);
    }
    if (first.empty()) continue;
    std::printf("  %s walked up to for %.0f m\n", name, Announcements::kLeg_m);
    print_distances("announced", first);
    print_distances("truly", truly_first);
    print_distances("told again", again);
    print_distances("truly", truly_again);
  }
}

/// The file of a map learnt from a survey of the seed's radio world.
std::string beacon_map(const Building& building, std::uint64_t seed) {
  const char* kept = std::getenv("FIONA_MAPS");
  const std::string file = kept ? std::string(kept) + "/" + std::to_string(seed) + ".beacons"
                                : ::testing::TempDir() + "walks" + std::to_string(::getpid()) + ".beacons";
  if (!kept || !std::filesystem::exists(file)) beacons::save(surveyed(building, seed), file);
  return file;
}

Tally walk(std::uint64_t count, Guidance guidance, Place place = Place::Truth,
           std::uint64_t first = number("FIONA_SEED", 1)) {
  const std::string file = FIONA_INSTITUTE_FILE;
  const Building building = Building::read(file);
  Tally tally;
  for (std::uint64_t seed = first; seed < first + count; ++seed) {
    Errand errand = draw_errand(building, seed + number("FIONA_ERRANDS", 0));
    errand.seed = seed;
    const std::string beacons = place == Place::Beacons ? beacon_map(building, seed) : "";
    const Outcome outcome = lead(building, file, errand, guidance, place, beacons);
    if (!beacons.empty() && std::getenv("FIONA_MAPS") == nullptr) std::filesystem::remove(beacons);
    ++tally.walks;
    tally.errors_m.insert(tally.errors_m.end(), outcome.errors_m.begin(), outcome.errors_m.end());
    tally.inside += outcome.inside;
    tally.wrong_level += outcome.wrong_level;
    tally.unplaced += outcome.unplaced;
    tally.arrived += outcome.arrived ? 1 : 0;
    tally.told_so += outcome.arrived && outcome.told_so ? 1 : 0;
    tally.reroutes += outcome.reroutes;
    tally.time += outcome.took_s / errand.route_s;
    if (outcome.at_door_s) tally.to_door.push_back(*outcome.at_door_s / errand.route_s);
    tally.faults += static_cast<int>(outcome.faults.size());
    tally.untimely += static_cast<int>(outcome.untimely.size());
    tally.announcements.insert(tally.announcements.end(), outcome.announcements.begin(), outcome.announcements.end());
    const bool all_well = outcome.told_so && outcome.arrived && outcome.faults.empty() && outcome.untimely.empty();
    if (guidance == Guidance::Whole && !all_well) {
      std::printf("%s: %s after %.0f s of %.0f s\n", errand.text().c_str(), outcome.ending.c_str(), outcome.took_s,
                  errand.route_s);
      for (const auto* wrong : {&outcome.faults, &outcome.untimely}) {
        for (const std::string& one : *wrong) std::printf("  %s\n", one.c_str());
      }
    }
    if (std::getenv("FIONA_COURSE") != nullptr) {
      for (const std::string& line : outcome.course) std::printf("  %s\n", line.c_str());
    }
  }
  std::printf(
      "seeds %llu to %llu: %d of %d arrived, to the door in %.2f times the route's time (p90 %.2f, p95 %.2f); %d were "
      "told so, after %.2f; %d times rerouted, %d faults, %d untimely\n",
      static_cast<unsigned long long>(first), static_cast<unsigned long long>(first + count - 1), tally.arrived,
      tally.walks, mean(tally.to_door), percentile(tally.to_door, 0.90), percentile(tally.to_door, 0.95), tally.told_so,
      tally.time / tally.walks, tally.reroutes, tally.faults, tally.untimely);
  if (place == Place::Beacons) {
    std::printf(
        "  position error: median %.2f m, p95 %.2f m, %.1f %% in the 95 %% region; wrong level %d s, no place %d s, of "
        "%zu s\n",
        percentile(tally.errors_m, 0.5), percentile(tally.errors_m, 0.95),
        100.0 * tally.inside / static_cast<double>(tally.errors_m.size()), tally.wrong_level, tally.unplaced,
        tally.errors_m.size() + static_cast<std::size_t>(tally.unplaced));
  }
  print_announcements(tally.announcements);
  std::fflush(stdout);
  return tally;
}

TEST(Walks, PeopleAreLedToTheirRooms) {
  const Tally tally = walk(number("FIONA_WALKS", 8), Guidance::Whole);
  EXPECT_GE(tally.share(), 0.99);
  EXPECT_EQ(tally.faults + tally.untimely, 0);
}

/// In one walk of a hundred the place may be too far off for a word to come in time.
TEST(Walks, PeopleWhoseBeaconsAreHeardAreFoundOnTheirWays) {
  if (FIONA_SANITIZED) GTEST_SKIP() << "a survey takes minutes under a sanitizer";
  const Tally tally = walk(number("FIONA_WALKS", 2), Guidance::Whole, Place::Beacons);
  EXPECT_EQ(tally.faults, 0);
  EXPECT_LE(tally.untimely, tally.walks / 100);
  EXPECT_LE(percentile(tally.errors_m, 0.5), 1.5);
  EXPECT_LE(percentile(tally.errors_m, 0.95), 4.0);
  EXPECT_LE(tally.wrong_level + tally.unplaced, static_cast<int>(tally.errors_m.size() / 20));
  if (std::getenv("FIONA_WALKS") != nullptr) {
    EXPECT_GE(tally.share(), 0.99);
  }
}

/// The cabin holds off some signals more than others, and once they walk again all of it is news.
TEST(Walks, WhoComesOutOfALiftIsNotLookedForElsewhere) {
  if (FIONA_SANITIZED) GTEST_SKIP() << "a survey takes minutes under a sanitizer";
  for (const std::uint64_t seed : {44, 188}) {
    const Tally tally = walk(1, Guidance::Whole, Place::Beacons, seed);
    EXPECT_LE(percentile(tally.errors_m, 0.95), 4.0) << "seed " << seed;
    ASSERT_GT(tally.errors_m.size(), 20U);
    // They were looked for 13 m away. The first seconds are those of the first place.
    EXPECT_LE(*std::max_element(tally.errors_m.begin() + 10, tally.errors_m.end()), 6.0) << "seed " << seed;
  }
}

/// They had been on the stairs for most of what they had heard, and it was looked for as if they had stood on them.
TEST(Walks, WhoComesDownStairsIsNotPutBackOnThem) {
  if (FIONA_SANITIZED) GTEST_SKIP() << "a survey takes minutes under a sanitizer";
  const Tally tally = walk(1, Guidance::Whole, Place::Beacons, 1252);
  ASSERT_GT(tally.errors_m.size(), 35U);
  EXPECT_LE(*std::max_element(tally.errors_m.begin() + 10, tally.errors_m.end()), 4.0);
}

TEST(Walks, WithGuidanceMutedNextToNobodyArrives) {
  const Tally tally = walk(number("FIONA_WALKS", 8), Guidance::Muted);
  EXPECT_LT(tally.share(), 0.05);
}

TEST(Walks, ByAPlaceThatStaysAtTheStartNextToNobodyArrives) {
  const Tally tally = walk(number("FIONA_WALKS", 8), Guidance::Whole, Place::Start);
  EXPECT_LT(tally.share(), 0.10);
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
