// fiona-navigation-bench [FOLDER]: a way through each station of FOLDER ($FIONA_DATA/osm_indoor, else
// ../shared/data/osm_indoor) as navigation finds it: the tasks as a planning problem, the optimal plan, and the path,
// for walkers with four profiles. 99th percentile; beside it Dijkstra's algorithm on the bare graph, measured in turns.
// Exit code 1 if any goal is short.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "fiona/building/building.hpp"
#include "level_map.hpp"
#include "level_plan.hpp"
#include "planner.hpp"
#include "task_graph.hpp"
#include "timing.hpp"

namespace {

namespace fs = std::filesystem;
using fiona::bench::milliseconds_of;
using fiona::bench::percentile;
using fiona::building::Building;
using fiona::building::PathPoint;
using fiona::building::RouteOptions;
using fiona::guidance::LevelPlan;
using fiona::guidance::TaskGraph;

constexpr double kMost_ms = 10;
constexpr int kRoutes = 1000;

Building read_station(const fs::path& packed) {
  if (packed.extension() != ".xz") return Building::read(packed);
  const fs::path plain = fs::temp_directory_path() / ("navigation-bench-" + packed.stem().string());
  if (std::system(("xz -dc '" + packed.string() + "' > '" + plain.string() + "'").c_str()) != 0) {
    throw std::runtime_error("cannot unpack " + packed.string());
  }
  Building building = Building::read(plain);
  fs::remove(plain);
  return building;
}

/// A way, or none where the planner proves that there is none.
void find(TaskGraph& tasks, const PathPoint& from, const PathPoint& to) {
  const auto request = tasks.request(from, to);
  const auto answer =
      fiona::planning::plan({.domain = fiona::guidance::task_domain(), .problem = request.problem(), .optimal = true});
  fiona::navigation::CommPlan plan;
  for (const auto& step : answer.steps) {
    auto& added = *plan.add_steps();
    added.set_action(step.action);
    for (const std::string& argument : step.arguments) added.add_arguments(argument);
  }
  if (answer.outcome == fiona::planning::PlanAnswer::Outcome::Solved) {
    request.route(plan);
  } else if (answer.outcome != fiona::planning::PlanAnswer::Outcome::Unsolvable) {
    throw std::runtime_error(answer.message);
  }
}

bool measure(const fs::path& file) {
  const Building station = read_station(file);
  const LevelPlan plan = fiona::guidance::read_level_plan(fiona::map_server::level_map_of(station, "station", {}));
  std::vector<PathPoint> places;
  for (const auto& connector : station.connectors()) {
    places.insert(places.end(), {connector.path.front(), connector.path.back()});
  }
  const RouteOptions profiles[] = {{}, {.stairs = false}, {.lift = false}, {.outdoors = false}};
  std::vector<std::unique_ptr<TaskGraph>> tasks(4);
  std::mt19937 random(1);
  std::vector<double> ours_ms, bare_ms, first_ms;
  for (int i = 0; i < kRoutes; ++i) {
    const PathPoint& from = places[random() % places.size()];
    const PathPoint& to = places[random() % places.size()];
    const RouteOptions& options = profiles[i % 4];
    auto& of_profile = tasks[static_cast<std::size_t>(i % 4)];
    const double took_ms = milliseconds_of([&] {
      if (!of_profile || !of_profile->suits(from, options))
        of_profile = std::make_unique<TaskGraph>(plan, from, options);
      find(*of_profile, from, to);
    });
    (i < 4 ? first_ms : ours_ms).push_back(took_ms);
    bare_ms.push_back(milliseconds_of([&] { station.route(from, to, options); }));
  }
  const double p99 = percentile(ours_ms, 0.99);
  const double bare = percentile(bare_ms, 0.99);
  const bool ok = p99 <= kMost_ms;
  std::printf(
      "navigation on %s, p99  %.2f ms  <= %.0f  %s   (%.1fx Dijkstra's %.2f ms; median %.2f ms, longest %.2f ms; "
      "the first of a profile %.2f ms)\n",
      file.filename().c_str(), p99, kMost_ms, ok ? "ok" : "short", p99 / bare, bare, percentile(ours_ms, 0.5),
      ours_ms.back(), percentile(first_ms, 1.0));
  std::fflush(stdout);
  return ok;
}

}  // namespace

int main(int count, char** words) {
  const char* data = std::getenv("FIONA_DATA");
  const fs::path folder = count > 1 ? fs::path(words[1]) : fs::path(data ? data : FIONA_SHARED_DATA) / "osm_indoor";
  if (!fs::exists(folder)) {
    std::printf("navigation: no maps of stations in %s: set FIONA_DATA\n", folder.c_str());
    return 0;
  }
  bool all = true;
  for (const char* map : {"da_hbf.osm.xz", "da_hbf_2.osm.pbf", "moorgate.osm.xz"}) {
    try {
      all = measure(folder / map) && all;
    } catch (const std::exception& error) {
      std::printf("navigation on %s  short   (error: %s)\n", map, error.what());
      all = false;
    }
  }
  return all ? 0 : 1;
}
