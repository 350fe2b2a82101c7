#pragma once

#include <optional>

#include "fiona/component.hpp"
#include "fiona/sensors.fiona.hpp"
#include "fiona/trace_player/params.pb.h"
#include "fiona/walk/imu_merger.hpp"
#include "fiona/walk/walk.hpp"

namespace fiona::trace_player {

/// Plays a recorded walk at the times of its recording, counted from when it became active. On a virtual clock that is
/// as fast as the components behind it can work, and always the same.
class TracePlayer final : public Component {
 public:
  using Component::Component;
  void on_start() override;
  void on_mode(std::string_view mode) override;

 private:
  void check(const TracePlayerParams& draft) const;
  void play_next();
  void play(const walk::Event& event);
  void play_imu(const walk::Event& event);
  void play_wifi(const walk::WifiRow& row);
  void collect_beacon(const walk::BeaconRow& row, TimePoint heard);
  void put_beacons();
  TimePoint time_of(std::int64_t t_ms) const;

  Params<TracePlayerParams> params_{*this, &TracePlayer::check};
  Provides<sensors::GetIMUService> imu_{*this, "imu", {.doc = "accelerometer, gyroscope and magnetometer, joined"}};
  Provides<sensors::RFSignalRSSIService> wifi_{
      *this, "wifi", {.doc = "rows of Wi-Fi scans, each with the time it was heard"}};
  Provides<sensors::IbeaconlistProvider> beacons_{*this, "beacons", {.doc = "iBeacons, as they are heard"}};
  Timer next_event_{*this, &TracePlayer::play_next};

  bool started_ = false;
  walk::Walk walk_;
  std::size_t next_ = 0;
  TimePoint begun_{};
  walk::ImuMerger merger_;
  sensors::CommiBeaconList heard_;
};

}  // namespace fiona::trace_player
