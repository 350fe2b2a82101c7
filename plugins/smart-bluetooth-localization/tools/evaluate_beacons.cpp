// How far the method is from the truth, and what each part of it is worth: the same walks with one part left out.
#include <algorithm>
#include <cmath>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <map>
#include <memory>
#include <numeric>
#include <span>
#include <sstream>
#include <string>
#include <vector>

#include <Eigen/LU>
#include <boost/program_options.hpp>

#include <fiona/error.hpp>
#include <fiona/tool.hpp>
#include <fiona/walk/dataset.hpp>

#include "level_map.hpp"
#include "survey_csv.hpp"
#include "survey_walks.hpp"

namespace {

namespace options = boost::program_options;
namespace beacons = fiona::beacons;
using beacons::Time;

constexpr double kChiSquare95 = 5.991;
constexpr double kLevelCost_m = 15.0;
constexpr std::int64_t kOldest_ms = 5000;
constexpr std::int64_t kAfterEnd_ms = 2000;  // a track may be one scan, and a first fix takes a second

struct Shown {
  std::int64_t t_ms;
  beacons::Estimate at;
};
using Tracks = std::map<std::string, std::vector<Shown>>;

struct Truth {
  std::string track;
  std::int64_t t_ms;
  double x_m, y_m;
  int level;
};

std::vector<Truth> read_truth(const std::string& file) {
  std::ifstream stream(file);
  std::string line;
  std::getline(stream, line);
  if (!line.starts_with("trace,t_ms,x,y,floor")) {
    throw fiona::Error(fiona::ErrorCode::Usage,
                       {.what = "this is no truth", .where = file, .expected = "trace,t_ms,x,y,floor", .found = line});
  }
  std::vector<Truth> truth;
  while (std::getline(stream, line)) {
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream cells(line);
    Truth t;
    if (cells >> t.track >> t.t_ms >> t.x_m >> t.y_m >> t.level) truth.push_back(t);
  }
  return truth;
}

double percentile(std::vector<double> values, double share) {
  if (values.empty()) return NAN;
  std::sort(values.begin(), values.end());
  const double place = share * static_cast<double>(values.size() - 1);
  const auto low = static_cast<std::size_t>(place);
  const double high = values[std::min(low + 1, values.size() - 1)];
  return values[low] + (place - static_cast<double>(low)) * (high - values[low]);
}

double log_score(const Eigen::Vector2d& error, const Eigen::Matrix2d& covariance) {
  return -0.5 * (error.dot(covariance.inverse() * error) + std::log(covariance.determinant())) - std::log(2 * M_PI);
}

struct Scores {
  std::vector<double> errors, costs, radii;
  std::map<std::string, std::vector<double>> by_track;
  std::size_t points = 0, inside = 0, wrong_level = 0;
  double log = 0.0;
  Eigen::Matrix2d second_moment = Eigen::Matrix2d::Zero();
};

Scores score(const std::vector<Truth>& truth, const Tracks& tracks) {
  Scores s;
  for (const Truth& t : truth) {
    ++s.points;
    const auto found = tracks.find(t.track);
    if (found == tracks.end()) continue;
    const auto after = std::upper_bound(found->second.begin(), found->second.end(), t.t_ms,
                                        [](std::int64_t time, const Shown& shown) { return time < shown.t_ms; });
    if (after == found->second.begin() || t.t_ms - std::prev(after)->t_ms > kOldest_ms) continue;
    const auto& at = std::prev(after)->at;
    const Eigen::Vector2d error(at.x_m - t.x_m, at.y_m - t.y_m);
    s.errors.push_back(error.norm());
    s.costs.push_back(error.norm() + kLevelCost_m * std::abs(at.level - t.level));
    s.by_track[t.track].push_back(error.norm());
    s.wrong_level += at.level != t.level;
    s.inside += error.dot(at.covariance.inverse() * error) <= kChiSquare95;
    s.radii.push_back(std::sqrt(kChiSquare95) * std::pow(at.covariance.determinant(), 0.25));
    s.log += log_score(error, at.covariance);
    s.second_moment += error * error.transpose();
  }
  return s;
}

void print(const std::string& name, const Scores& s) {
  const auto n = static_cast<double>(s.errors.size());
  if (n == 0) {
    throw fiona::Error(fiona::ErrorCode::Failed,
                       {.what = "no truth is covered", .next = "--truth FILE names that of the same walks"});
  }
  double track_means = 0.0;
  for (const auto& [track, errors] : s.by_track) {
    track_means += std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(errors.size());
  }
  // The constant covariance that is best on these very points: none that was chosen before can be better.
  const double constant = -0.5 * (2.0 + std::log((s.second_moment / n).determinant())) - std::log(2 * M_PI);
  const double median = percentile(s.errors, 0.5), radius = percentile(s.radii, 0.5);
  std::cout << std::left << std::setw(16) << name << std::right << std::fixed << std::setprecision(2) << " covered "
            << std::setw(6) << 100 * n / static_cast<double>(s.points) << " %  mean "
            << std::accumulate(s.errors.begin(), s.errors.end(), 0.0) / n << "  of tracks "
            << track_means / static_cast<double>(s.by_track.size()) << "  median " << median << "  p75+floors "
            << percentile(s.costs, 0.75) << "  wrong level " << s.wrong_level << "  in 95 % "
            << 100 * static_cast<double>(s.inside) / n << " %  radius/median " << radius / median << "  log score "
            << s.log / n << " (best constant " << constant << ")\n";
}

struct Variant {
  const char* name;
  void (*leave_out)(beacons::FilterOptions&);
};
constexpr Variant kVariants[] = {
    {"all", [](beacons::FilterOptions&) {}},
    {"without compass", [](beacons::FilterOptions& o) { o.compass = false; }},
    {"without bias", [](beacons::FilterOptions& o) { o.heading_bias = false; }},
    {"without walls", [](beacons::FilterOptions& o) { o.walls = false; }},
    {"without offset", [](beacons::FilterOptions& o) { o.rssi_offset = false; }},
};

void show(beacons::BeaconFilter& filter, std::int64_t t_ms, std::vector<Shown>& track) {
  if (const auto at = filter.estimate(); at.is_valid()) track.push_back({t_ms, at});
}

/// Rows without steps.
Tracks follow(const std::vector<beacons::TrackRow>& rows, const beacons::BeaconField& field,
              const std::function<beacons::BeaconFilter()>& make) {
  Tracks tracks;
  for (std::size_t i = 0; i < rows.size();) {
    beacons::BeaconFilter filter = make();
    auto& track = tracks[rows[i].track];
    const std::string name = rows[i].track;
    std::int64_t next = rows[i].t_ms;
    for (; i < rows.size() && rows[i].track == name; ++i) {
      for (; next <= rows[i].t_ms; next += 200) {
        filter.advance(Time(next));
        show(filter, next, track);
      }
      if (const auto beacon = field.find(rows[i].beacon)) filter.heard(*beacon, rows[i].rssi_dbm);
    }
    for (const std::int64_t end = next + kAfterEnd_ms; next < end; next += 200) {
      filter.advance(Time(next));
      show(filter, next, track);
    }
  }
  return tracks;
}

int run(int argc, char** argv) {
  options::options_description named(
      "usage: evaluate-beacons DIR|TRACKS.csv --map FILE --truth TRUTH.csv [--plan BUILDING.osm]");
  beacons::FilterOptions base;
  named.add_options()("help,h", "this text")("input", options::value<std::string>(),
                                             "walks, or track,t_ms,beacon,rssi_dbm")(
      "map", options::value<std::string>(), "beacon map")("plan", options::value<std::string>(), "building")(
      "truth", options::value<std::string>(), "trace,t_ms,x,y,floor")("survey", "replay the survey walks")(
      "variants", options::value<std::size_t>()->default_value(std::size(kVariants)), "how many: 1 leaves nothing out")(
      "seed", options::value(&base.seed), "")("particles", options::value(&base.particles), "")(
      "temper", options::value(&base.temper), "")("still-temper", options::value(&base.still_temper), "")(
      "silence", options::value(&base.silence), "")("bias", options::value(&base.heading_bias_sd_rad), "")(
      "drift", options::value(&base.heading_drift_rad), "")("held", options::value(&base.held_sd_rad), "")(
      "held-drift", options::value(&base.held_drift_rad), "")("still", options::value(&base.still_diffusion_m), "")(
      "free", options::value(&base.free_diffusion_m), "")("through", options::value(&base.through_wall), "")(
      "jump", options::value(&base.jump_rate_per_s), "")("offset-drift", options::value(&base.offset_drift_db), "")(
      "tracks", "errors of each track")("output,o", options::value<std::string>(),
                                        "trace,t_ms,x,y,floor,cov_xx,cov_xy,cov_yy");
  options::positional_options_description words;
  words.add("input", 1);
  options::variables_map given;
  options::store(options::command_line_parser(argc, argv).options(named).positional(words).run(), given);
  options::notify(given);
  if (given.count("help") != 0 || given.count("input") * given.count("map") * given.count("truth") == 0) {
    (given.count("help") != 0 ? std::cout : std::cerr) << named;
    return given.count("help") != 0 ? 0 : static_cast<int>(fiona::ErrorCode::Usage);
  }
  auto plan = std::make_shared<const beacons::FloorPlan>();
  if (given.count("plan") != 0) {
    const auto building = fiona::building::Building::read(given["plan"].as<std::string>());
    plan = std::make_shared<const beacons::FloorPlan>(fiona::map_server::level_map_of(building, "plan", {}));
  }
  const auto map = beacons::load(given["map"].as<std::string>());
  const auto field = std::make_shared<const beacons::BeaconField>(map, plan->extents());
  const auto truth = read_truth(given["truth"].as<std::string>());
  const std::string input = given["input"].as<std::string>();

  std::vector<fiona::radio::Journey> journeys;
  std::vector<beacons::TrackRow> rows;
  if (input.ends_with(".csv")) {
    rows = beacons::read_tracks(input);
  } else {
    const auto take = [&](const fiona::walk::Walk& walk) {
      journeys.push_back(fiona::radio::journey_of(walk));
      return true;
    };
    const auto dataset = fiona::walk::Dataset::open(input);
    given.count("survey") != 0 ? dataset.for_each_survey_walk(take) : dataset.for_each_test_walk(take);
  }
  for (const Variant& variant :
       std::span(kVariants).first(std::min(std::size(kVariants), given["variants"].as<std::size_t>()))) {
    beacons::FilterOptions filter_options = base;
    variant.leave_out(filter_options);
    const auto make = [&] {
      return beacons::BeaconFilter(field, plan, map.accuracy(), map.radio().offset(), filter_options);
    };
    Tracks tracks = follow(rows, *field, make);
    for (const auto& journey : journeys) {
      auto filter = make();
      beacons::replay(journey, *field, filter, [&](Time time) { show(filter, time.count(), tracks[journey.name]); });
    }
    const Scores scores = score(truth, tracks);
    print(variant.name, scores);
    if (given.count("tracks") != 0) {
      for (const auto& [track, errors] : scores.by_track) {
        std::cout << "  " << track << " mean "
                  << std::accumulate(errors.begin(), errors.end(), 0.0) / static_cast<double>(errors.size()) << '\n';
      }
    }
    if (given.count("output") != 0 && &variant == kVariants) {
      std::ofstream out(given["output"].as<std::string>());
      out << "trace,t_ms,x,y,floor,cov_xx,cov_xy,cov_yy\n";
      for (const auto& [name, track] : tracks) {
        for (const auto& [t_ms, at] : track) {
          out << name << ',' << t_ms << ',' << at.x_m << ',' << at.y_m << ',' << at.level << ',' << at.covariance(0, 0)
              << ',' << at.covariance(0, 1) << ',' << at.covariance(1, 1) << '\n';
        }
      }
      out.close();
      if (!out) {
        throw fiona::Error(fiona::ErrorCode::Failed, {.what = "cannot write " + given["output"].as<std::string>(),
                                                      .next = "-o FILE names one that can"});
      }
    }
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  return fiona::run_tool<options::error>([&] { return run(argc, argv); });
}
