#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string_view>

#include "fiona/building_simulator/params.pb.h"
#include "fiona/component.hpp"
#include "fiona/hmi.fiona.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/sensors.fiona.hpp"
#include "fiona/simulator/imu_model.hpp"

namespace fiona::simulator {

/// A person with a phone who walks from room to room of a building: what the phone's sensors say, and where
/// the person really is. The same parameters give the same messages, at the same times after the start.
class BuildingSimulator : public Component {
 public:
  explicit BuildingSimulator(Hull& hull) : BuildingSimulator(hull, false) {}
  ~BuildingSimulator() override;

 protected:
  /// `guided`: the person does what they hear.
  BuildingSimulator(Hull& hull, bool guided);
  /// [strand] The person hears it now.
  void hear(const hmi::Instruction& instruction);

 private:
  using Parameters = building_simulator::Parameters;
  struct World;

  void on_start() override;
  void on_mode(std::string_view mode) override;
  void check(const Parameters& draft) const;

  void produce_imu();
  void produce_truth();
  void resume();
  void walk_on();
  void step();
  void put_radio();
  void end();

  Params<Parameters> params_{*this, &BuildingSimulator::check};
  Provides<sensors::GetIMUService> imu_{
      *this,
      "imu",
      &BuildingSimulator::produce_imu,
      ImuModel::kPeriod,
      {.doc = "the phone in the person's hand: accelerometer, gyroscope, magnetometer, 50 Hz"}};
  Provides<sensors::RFSignalRSSIService> wifi_{
      *this, "wifi", {.doc = "one message for each row of the phone's Wi-Fi scans, dated when it was really heard"}};
  Provides<sensors::IbeaconlistProvider> beacons_{
      *this, "beacons", {.doc = "the iBeacons heard in the last 0.3 s; an empty list if there was none"}};
  Provides<localisation::LocationProvider> truth_{
      *this,
      "truth",
      &BuildingSimulator::produce_truth,
      std::chrono::milliseconds(200),
      {.doc = "where the person really is: no localisation has this port, compare with it"}};

  const bool guided_;
  std::unique_ptr<World> world_;
  /// The instance's time at the simulation's zero. A pause moves it on: the person stands still meanwhile.
  TimePoint begun_{};
  std::int64_t periods_ = 0;              ///< of ImuModel::kPeriod, simulated so far
  std::chrono::milliseconds resumed_{0};  ///< the simulation's time at which it last went on after a pause
  bool ended_ = false;
};

/// The same, and the person knows nothing of the building, stands until there is an instruction, and then does as it
/// says.
class GuidedWalkSimulator final : public BuildingSimulator {
 public:
  explicit GuidedWalkSimulator(Hull& hull) : BuildingSimulator(hull, true) {}

 private:
  void on_instruction(const hmi::Instruction& instruction) { hear(instruction); }

  Requires<hmi::InstructionProvider> instructions_{
      *this, "instructions", &GuidedWalkSimulator::on_instruction, {.doc = "what the person is told to do"}};
};

}  // namespace fiona::simulator
