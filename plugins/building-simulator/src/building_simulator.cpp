#include "fiona/simulator/building_simulator.hpp"

#include <fmt/format.h>
#include <google/protobuf/util/message_differencer.h>

#include <algorithm>
#include <cmath>
#include <variant>

#include "fiona/building/building.hpp"
#include "fiona/hull.hpp"
#include "fiona/simulator/guided_walker.hpp"
#include "fiona/simulator/radio_model.hpp"
#include "fiona/simulator/walker.hpp"
#include "messages.hpp"

namespace fiona::simulator {
namespace {

using building::Building;
using building_simulator::Parameters;

/// A machine that was busy for longer does not make up for it: the person stood still.
constexpr std::int64_t kMostMissedPeriods = 50;
constexpr std::size_t kMostWarnings = 5;
constexpr auto kPeriod = ImuModel::kPeriod;

/// Faster walkers make longer steps and more of them: about equally, by the square root of the speed each
/// (Grieve and Gear, "The relationships between length of stride, step frequency, time of swing and speed of
/// walking", 1966).
Gait gait_of(const Parameters& parameters) {
  Gait gait;
  gait.cadence_hz *= std::sqrt(parameters.speed_mps() / gait.speed_mps);
  gait.speed_mps = parameters.speed_mps();
  gait.stairs_speed_mps = std::min(gait.stairs_speed_mps, gait.speed_mps);
  return gait;
}

Walker::Options walker_options(const Parameters& parameters) {
  Walker::Options options;
  options.gait = gait_of(parameters);
  options.start_room = parameters.start_room();
  options.routes = {.stairs = parameters.stairs(), .lift = parameters.lift()};
  options.longest_pause = milliseconds(std::llround(1000.0 * parameters.longest_pause_s()));
  options.shortest_pause = options.longest_pause / 4;
  return options;
}

/// Walks of one world do not repeat those of the next seed.
std::uint64_t walker_seed(const Parameters& parameters) {
  return parameters.seed() + (std::uint64_t{parameters.walk()} << 32u);
}

}  // namespace

/// What is made when the instance starts. The parts refer to the building: it does not move.
struct BuildingSimulator::World {
  using Person = std::variant<Walker, GuidedWalker>;

  World(const std::filesystem::path& file, const Parameters& parameters, bool guided)
      : building(Building::read(file)),
        person(person_of(building, parameters, guided)),
        imu(parameters.seed(), {}, parameters.walk()),
        radio(building, parameters.seed(), parameters.drawn_radio() ? drawn_radio(parameters.seed()) : RadioOptions{},
              parameters.walk()) {}

  static Person person_of(const Building& building, const Parameters& parameters, bool guided) {
    if (!guided)
      return Person(std::in_place_type<Walker>, building, walker_seed(parameters), walker_options(parameters));
    GuidedWalker::Options options;
    options.gait = gait_of(parameters);
    options.gait.stairs_speed_mps = std::min(building::kStairsPace_mps, parameters.speed_mps());
    options.start_room = parameters.start_room();
    options.access = parameters.access();
    return Person(std::in_place_type<GuidedWalker>, building, walker_seed(parameters), std::move(options));
  }
  const Truth& truth() const {
    return std::visit([](const auto& one) -> const Truth& { return one.truth(); }, person);
  }
  void advance(std::chrono::milliseconds to) {
    std::visit([to](auto& one) { one.advance(to); }, person);
  }

  const Building building;
  Person person;
  ImuModel imu;
  RadioModel radio;
};

BuildingSimulator::BuildingSimulator(Hull& hull, bool guided) : Component(hull), guided_(guided) {}
BuildingSimulator::~BuildingSimulator() = default;

void BuildingSimulator::check(const Parameters& draft) const {
  if (!world_) return;
  Parameters other = draft;
  other.set_duration_s(params_->duration_s());
  if (google::protobuf::util::MessageDifferencer::Equals(other, *params_)) return;
  throw Error(ErrorCode::NotAllowed, {.what = "the walk has begun: only duration_s can still be changed",
                                      .where = name(),
                                      .next = "unload " + name() + ", then load it with the new parameters"});
}

void BuildingSimulator::on_start() {
  const std::filesystem::path file = params_->building().empty()
                                         ? resource("building.osm")
                                         : building::named_file(params_->building(), hull().share());
  world_ = std::make_unique<World>(file, *params_, guided_);
  const auto& warnings = world_->building.warnings();
  for (std::size_t i = 0; i < std::min(warnings.size(), kMostWarnings); ++i) log(LogLevel::Warning, warnings[i]);
  if (warnings.size() > kMostWarnings) {
    log(LogLevel::Warning, fmt::format("{} more like this in {}", warnings.size() - kMostWarnings, file.string()));
  }
  log(LogLevel::Info, fmt::format("{}: {} levels, {} transmitters", world_->building.name(),
                                  world_->building.levels().size(), world_->radio.transmitters()));
}

void BuildingSimulator::on_mode(std::string_view mode) {
  if (mode != kModeNeutral) resume();
}

void BuildingSimulator::resume() {
  resumed_ = periods_ * kPeriod;
  begun_ = now() - resumed_;
}

/// Brings the simulation to the present. Both producers call it, so their order within an instant does not
/// matter.
void BuildingSimulator::walk_on() {
  // To the nearest period: a task that runs a little early or late does not shift the grid.
  std::int64_t due = (now() - begun_ + kPeriod / 2) / kPeriod;
  if (due - periods_ > kMostMissedPeriods) {
    log(LogLevel::Warning, fmt::format("the machine was busy for {:.1f} s: the person stood still",
                                       to_seconds((due - periods_) * kPeriod)));
    resume();
    due = periods_;
  }
  while (periods_ < due && !ended_) step();
}

void BuildingSimulator::step() {
  ++periods_;
  world_->advance(periods_ * kPeriod);
  const Truth& truth = world_->truth();
  imu_.put(imu_message(world_->imu.sample(truth)), begun_ + truth.t);
  put_radio();
  const double duration_s = params_->duration_s();
  if (duration_s > 0.0 && to_seconds(periods_ * kPeriod) >= duration_s) end();
}

void BuildingSimulator::put_radio() {
  RadioOutput heard = world_->radio.advance(world_->truth());
  for (WifiScan& scan : heard.scans) {
    // What was heard before a pause cannot be dated on a clock that went on meanwhile.
    std::erase_if(scan.readings, [this](const WifiReading& reading) { return reading.heard < resumed_; });
    std::stable_sort(scan.readings.begin(), scan.readings.end(),
                     [](const WifiReading& a, const WifiReading& b) { return a.heard < b.heard; });
    for (const WifiReading& reading : scan.readings) {
      wifi_.put(wifi_message(reading, name(), begun_), begun_ + reading.heard);
    }
  }
  for (const BeaconBatch& batch : heard.batches) beacons_.put(beacon_list(batch, begun_), begun_ + batch.t);
}

void BuildingSimulator::end() {
  ended_ = true;
  end_run(0, fmt::format("the walk of {:g} s is over", params_->duration_s()));
}

void BuildingSimulator::hear(const hmi::Instruction& instruction) {
  auto* guided = std::get_if<GuidedWalker>(&world_->person);
  if (!guided || ended_) return;
  walk_on();
  guided->hear(instruction);
}

void BuildingSimulator::produce_imu() { walk_on(); }

void BuildingSimulator::produce_truth() {
  if (ended_) return;
  walk_on();
  const Truth& truth = world_->truth();
  truth_.put(truth_message(truth, ImuOptions{}), begun_ + truth.t);
}

}  // namespace fiona::simulator
