#include <chrono>
#include <cmath>
#include <cstdint>
#include <exception>
#include <fstream>
#include <iostream>
#include <memory>
#include <optional>
#include <string>

#include <boost/program_options.hpp>

#include <fiona/error.hpp>
#include <fiona/walk/dataset.hpp>
#include <fiona/walk/imu_merger.hpp>

#include "radio_filter.hpp"
#include "radio_map_file.hpp"
#include "step_tracker.hpp"

namespace {

namespace options = boost::program_options;
namespace radio = fiona::radio;
namespace walk = fiona::walk;
using std::chrono::milliseconds;

constexpr std::int64_t kOutput_ms = 200;

/// Replays one walk in the order of its events and writes what a live navigator would show, five times a second.
class Replay {
 public:
  Replay(const walk::Walk& walk, std::shared_ptr<const radio::RadioMap> map, const radio::FilterOptions& filter,
         std::ostream& out)
      : walk_(walk), filter_(std::move(map), filter), out_(out) {}

  void run() {
    if (walk_.events.empty()) return;
    std::int64_t next_ms = (walk_.events.front().t_ms / kOutput_ms + 1) * kOutput_ms;
    for (const walk::Event& event : walk_.events) {
      for (; next_ms < event.t_ms; next_ms += kOutput_ms) show(next_ms);
      feed(event);
    }
    show(next_ms);
  }

 private:
  void feed(const walk::Event& event) {
    const milliseconds time(event.t_ms);
    if (const auto* wifi = std::get_if<walk::WifiRow>(&event.data)) {
      filter_.signal(time, {walk_.transmitters[wifi->transmitter], radio::Radio::WiFi, wifi->rssi_dbm,
                            milliseconds(wifi->heard_ms)});
    } else if (const auto* beacon = std::get_if<walk::BeaconRow>(&event.data)) {
      filter_.signal(time, {walk_.transmitters[beacon->transmitter], radio::Radio::Bluetooth, beacon->rssi_dbm, time});
    } else if (const auto imu = merger_.feed(event)) {
      const auto step = steps_.feed({milliseconds(imu->t_ms), Eigen::Vector3d(imu->acceleration_g),
                                     Eigen::Vector3d(imu->rate_dps), Eigen::Vector3d(imu->field_gauss)});
      if (step) filter_.step({step->time, step->length_m, step->length_sd_m, step->heading_rad, step->heading_sd_rad});
    }
  }

  void show(std::int64_t t_ms) {
    filter_.advance(milliseconds(t_ms));
    const radio::Estimate at = filter_.estimate();
    if (!at.is_valid()) return;
    out_ << walk_.name << ',' << t_ms << ',' << at.x_m << ',' << at.y_m << ',' << at.level << ',' << at.covariance(0, 0)
         << ',' << at.covariance(0, 1) << ',' << at.covariance(1, 1) << '\n';
  }

  const walk::Walk& walk_;
  radio::RadioFilter filter_;
  walk::ImuMerger merger_;
  fiona::steps::StepTracker steps_;
  std::ostream& out_;
};

int run(int argc, char** argv) {
  options::options_description named("usage: evaluate-walks DIR --map FILE -o OUT.csv");
  named.add_options()("help,h", "this text")("folder", options::value<std::string>(), "recorded walks")(
      "map", options::value<std::string>(), "radio map, see fiona-radiomap")(
      "output,o", options::value<std::string>(), "trace,t_ms,x,y,floor and the covariance, m^2")(
      "seed", options::value<std::uint64_t>()->default_value(1), "of the filter")(
      "particles", options::value<std::size_t>()->default_value(radio::FilterOptions{}.particles), "of the filter");
  options::positional_options_description words;
  words.add("folder", 1);
  options::variables_map given;
  options::store(options::command_line_parser(argc, argv).options(named).positional(words).run(), given);
  if (given.count("help") != 0 || given.count("folder") * given.count("map") * given.count("output") == 0) {
    (given.count("help") != 0 ? std::cout : std::cerr) << named;
    return given.count("help") != 0 ? 0 : static_cast<int>(fiona::ErrorCode::Usage);
  }
  const auto dataset = walk::Dataset::open(given["folder"].as<std::string>());
  const auto map = std::make_shared<const radio::RadioMap>(radio::load(given["map"].as<std::string>()));
  std::ofstream out(given["output"].as<std::string>());
  out << "trace,t_ms,x,y,floor,var_x,cov_xy,var_y\n";
  radio::FilterOptions filter;
  filter.seed = given["seed"].as<std::uint64_t>();
  filter.particles = given["particles"].as<std::size_t>();
  dataset.for_each_test_walk([&](const walk::Walk& walk) {
    Replay(walk, map, filter, out).run();
    return true;
  });
  out.close();
  if (!out) throw fiona::Error(fiona::ErrorCode::Failed, "cannot write " + given["output"].as<std::string>());
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const fiona::Error& error) {
    std::cerr << "error: " << error.what() << '\n';
    return static_cast<int>(error.code());
  } catch (const options::error& error) {
    std::cerr << "error: " << error.what() << '\n';
    return static_cast<int>(fiona::ErrorCode::Usage);
  } catch (const std::exception& error) {
    std::cerr << "error: " << error.what() << '\n';
    return static_cast<int>(fiona::ErrorCode::Failed);
  }
}
