// The simulator's radio beside that of a real building. The recording is no part of the project: FIONA_DATA=DIR says
// where it is; without it the comparison is skipped.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <fiona/walk/dataset.hpp>

#include "fiona/simulator/radio_model.hpp"
#include "fiona/simulator/random.hpp"
#include "radio_figures.hpp"
#include "surveyor.hpp"

namespace fiona::walks {
namespace {

using building::Building;

constexpr std::size_t kWorlds = 4;

/// Ten minutes of one beacon by someone who walks to and fro, with noise that is correlated over so long.
radio::Journey made_up(double noise_db, double lasting_s) {
  radio::Journey journey;
  journey.transmitters = {"beacon"};
  simulator::Random random(1);
  double left_db = noise_db * random.normal();
  for (int t_ms = 0; t_ms <= 600'000; t_ms += 200) {
    if (t_ms % 20'000 == 0) journey.way_points.push_back({t_ms, {t_ms % 40'000 == 0 ? 0.0 : 20.0, 0.0, 0}});
    const double stays = lasting_s > 0.0 ? std::exp(-0.2 / lasting_s) : 0.0;
    left_db = stays * left_db + noise_db * std::sqrt(1.0 - stays * stays) * random.normal();
    if (t_ms % 1000 == 800) continue;
    journey.told.push_back(
        {radio::Time(t_ms),
         radio::Journey::Row{0, radio::Radio::Bluetooth, static_cast<float>(-70.0 + left_db), radio::Time(t_ms)}});
  }
  return journey;
}

TEST(RadioFigures, NoiseOfEachReadingIsAsLargeAtAnyLagAndNotCorrelated) {
  const RadioFigures figures = figures_of({made_up(4.0, 0.0)});
  EXPECT_NEAR(figures.second_db, 4.0, 0.2);
  EXPECT_NEAR(figures.revisit_db, 4.0, 0.2);
  for (std::size_t lag = 0; lag < RadioFigures::kLags_s.size(); ++lag) {
    EXPECT_NEAR(figures.walking_db[lag], 4.0, 0.3) << RadioFigures::kLags_s[lag];
    EXPECT_NEAR(figures.correlation[lag], 0.0, 0.1) << RadioFigures::kLags_s[lag];
  }
}

TEST(RadioFigures, NoiseThatLastsIsCorrelatedForAsLong) {
  const RadioFigures figures = figures_of({made_up(4.0, 1.0)});
  EXPECT_LT(figures.second_db, 3.0);
  for (std::size_t lag = 0; lag < RadioFigures::kLags_s.size(); ++lag)
    EXPECT_NEAR(figures.correlation[lag], std::exp(-RadioFigures::kLags_s[lag]), 0.12) << RadioFigures::kLags_s[lag];
}

TEST(RadioFigures, OneAdvertisementOfFiveThatIsNotHeardIsMissed) {
  EXPECT_NEAR(figures_of({made_up(4.0, 0.0)}).missed, 0.2, 0.01);
}

RadioFigures of_recording(const std::filesystem::path& folder) {
  std::vector<radio::Journey> walks;
  walk::Dataset::open(folder).for_each_survey_walk([&](const walk::Walk& walk) {
    radio::Journey journey = radio::journey_of(walk);
    // Who recorded them stood for a minute before they walked.
    if (!journey.way_points.empty())
      journey.way_points.insert(journey.way_points.begin(), {journey.begin.count(), journey.way_points.front().second});
    walks.push_back(std::move(journey));
    return true;
  });
  return figures_of(walks);
}

/// A minute in the middle of a room.
simulator::Trace stand(const Building& building, const building::Room& room, std::uint64_t seed, std::uint64_t run) {
  simulator::RadioModel radio(building, seed, simulator::drawn_radio(seed), run);
  simulator::Trace trace{.id = room.name, .level = room.level, .duration = std::chrono::minutes(1)};
  simulator::Truth at;
  at.x_m = room.centre.x_m, at.y_m = room.centre.y_m, at.level = room.level;
  at.height_m = building.height_m(room.level);
  for (; at.t <= trace.duration; at.t += std::chrono::milliseconds(20)) {
    if (at.t == std::chrono::milliseconds(0) || at.t == trace.duration) trace.waypoints.push_back(at);
    for (const auto& batch : radio.advance(at).batches)
      trace.beacons.insert(trace.beacons.end(), batch.readings.begin(), batch.readings.end());
  }
  return trace;
}

RadioFigures of_world(const Building& building, std::uint64_t seed) {
  std::vector<radio::Journey> walks = survey_of(building, seed);
  for (std::size_t i = 0; i < building.rooms().size(); i += 6)
    walks.push_back(journey_of(stand(building, building.rooms()[i], seed, 1'000'000 + i)));
  return figures_of(walks);
}

struct Row {
  std::string name;
  std::function<double(const RadioFigures&)> value;
  double within = 0.0;  ///< so many times the real figure, and so much less of it; 0: it is only shown
};

/// A world's noise is drawn between 2.5 and 5 dB, on both sides of the real one.
constexpr double kSpread = 1.8;
/// Walls and shadows are more of what the simulator's readings say, and noise less.
constexpr double kCorrelation = 2.5;

std::vector<Row> rows_by_lag() {
  std::vector<Row> standing, walking, correlation;
  for (std::size_t i = 0; i < RadioFigures::kLags_s.size(); ++i) {
    char lag[16];
    std::snprintf(lag, sizeof lag, "%.1f s", RadioFigures::kLags_s[i]);
    standing.push_back(
        {std::string("standing, ") + lag + " apart", [i](const RadioFigures& f) { return f.standing_db[i]; }, kSpread});
    walking.push_back(
        {std::string("walking, ") + lag + " apart", [i](const RadioFigures& f) { return f.walking_db[i]; }, kSpread});
    const bool last = i + 1 == RadioFigures::kLags_s.size();  // next to nothing with either
    correlation.push_back({std::string("correlation, ") + lag + " apart",
                           [i](const RadioFigures& f) { return f.correlation[i]; }, last ? 0.0 : kCorrelation});
  }
  std::vector<Row> all = standing;
  all.insert(all.end(), walking.begin(), walking.end());
  all.insert(all.end(), correlation.begin(), correlation.end());
  return all;
}

std::vector<Row> rows() {
  std::vector<Row> all = rows_by_lag();
  all.push_back({"about the mean of a second", [](const RadioFigures& f) { return f.second_db; }, kSpread});
  all.push_back({"the same place again", [](const RadioFigures& f) { return f.revisit_db; }, kSpread});
  all.push_back({"there on another walk", [](const RadioFigures& f) { return f.other_walk_db; }, kSpread});
  all.push_back({"about the path loss", [](const RadioFigures& f) { return f.path_loss_db; }, kSpread});
  all.push_back({"of walks' means", [](const RadioFigures& f) { return f.walks_db; }});
  all.push_back({"share missed", [](const RadioFigures& f) { return f.missed; }});
  all.push_back({"share missed above -80 dBm", [](const RadioFigures& f) { return f.missed_of_strong; }});
  return all;
}

/// What is not held to a factor is what the simulator is known not to do: the README of its plugin says so.
TEST(RadioWorld, ItsReadingsSpreadAndLastAsThoseOfRealBeacons) {
  const char* data = std::getenv("FIONA_DATA");
  const std::filesystem::path folder = std::filesystem::path(data ? data : FIONA_SHARED_DATA) / "ipin2023";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no recording at " << folder << ": set FIONA_DATA";
  const RadioFigures real = of_recording(folder);
  const Building building = Building::read(FIONA_INSTITUTE_FILE);
  std::vector<RadioFigures> worlds;
  for (std::uint64_t seed = 1; seed <= kWorlds; ++seed) worlds.push_back(of_world(building, seed));
  std::printf("%-28s %8s   simulator, seeds 1 to %zu\n", "dB, or a share", "ipin2023", kWorlds);
  for (const Row& row : rows()) {
    std::printf("%-28s %8.2f  ", row.name.c_str(), row.value(real));
    for (const RadioFigures& world : worlds) {
      std::printf(" %5.2f", row.value(world));
      if (row.within == 0.0) continue;
      EXPECT_LE(row.value(world), row.value(real) * row.within) << row.name;
      EXPECT_GE(row.value(world), row.value(real) / row.within) << row.name;
    }
    std::printf("\n");
  }
}

}  // namespace
}  // namespace fiona::walks
