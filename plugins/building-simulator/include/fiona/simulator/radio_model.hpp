#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <fiona/building/building.hpp>

#include "fiona/simulator/random.hpp"
#include "fiona/simulator/walker.hpp"

namespace fiona::simulator {

struct WifiReading {
  std::string bssid{};
  int rssi_dbm = 0;
  int frequency_mhz = 0;
  milliseconds heard{0};  ///< when the phone really heard it: stale rows are older than their scan
};

struct WifiScan {
  milliseconds t{0};
  std::vector<WifiReading> readings{};
};

struct BeaconReading {
  milliseconds heard{0};
  std::string uuid{};
  int major = 0;
  int minor = 0;
  int measured_power_dbm = 0;  ///< received at 1 m, as the beacon says of itself
  int rssi_dbm = 0;
  double distance_m = 0.0;  ///< estimate from the two, see beacon_distance_m
};

/// The device address of a simulated beacon, as `CommiBeacon` has it: always the same for the same advertisement.
std::string beacon_address(const BeaconReading& beacon);

struct BeaconBatch {
  milliseconds t{0};
  std::vector<BeaconReading> readings{};
};

struct RadioOutput {
  std::vector<WifiScan> scans{};
  std::vector<BeaconBatch> batches{};
};

struct RadioOptions {
  double path_loss_exponent = 2.1;  ///< in the open; walls and floors come on top
  double most_wall_loss_db = 45.0;  ///< beyond it the wave finds a way around
  double floor_loss_db = 18.3;      ///< COST 231: L = floor_loss n^((n + 2) / (n + 1) - 0.46)
  double shadowing_db = 4.0;        ///< standard deviation, constant in place
  double shadowing_size_m = 3.0;
  double wifi_noise_db = 2.0;  ///< from reading to reading
  double beacon_noise_db = 3.5;
  double wifi_sensitivity_dbm = -91.0;
  double beacon_sensitivity_dbm = -96.0;
  double miss_share = 0.06;      ///< readings lost to collisions
  double stale_share = 0.5;      ///< of the transmitters not heard now, those that a scan repeats
  milliseconds stale_age{8000};  ///< older readings are forgotten
  milliseconds scan_period{2000};
  milliseconds scan_sweep{1200};  ///< the phone goes through the channels this long before a scan is told
  milliseconds batch_period{300};
};

/// Another radio world with each seed: what differs from building to building, within what is measured in such
/// (ITU-R P.1238, tables 2 and 3; COST 231, chapter 4.7).
RadioOptions drawn_radio(std::uint64_t seed);

/// The distance by the log-distance path loss: 10^((measured power - rssi) / (10 n)), n = 2.
double beacon_distance_m(int measured_power_dbm, int rssi_dbm);

/// Wi-Fi and iBeacons of a building. The transmitters are landmarks of its file: `fiona:wifi=BSSID` (with
/// `fiona:frequency_mhz`, default 2412; `fiona:power_1m`, default -40 dBm) and
/// `fiona:beacon=UUID/MAJOR/MINOR` (with `fiona:measured_power`, default -59 dBm).
class RadioModel {
 public:
  /// Throws fiona::Error that names the landmark if one of its tags cannot be read. `building` must outlive
  /// this. The shadows are those of the seed; the noise also depends on `run`: another walk in the same
  /// building.
  RadioModel(const building::Building& building, std::uint64_t seed, RadioOptions options = {}, std::uint64_t run = 0);

  /// All that was heard since the call before, with the person at `truth`. Call it at least every 100 ms:
  /// what is heard in between counts as heard here. `phone_height` is taken as 1.2 m above the floor.
  RadioOutput advance(const Truth& truth);

  /// The received power without noise: path, walls, floors, shadowing. `transmitter` counts the landmarks
  /// with a transmitter, in the order of the file.
  double mean_rssi_dbm(std::size_t transmitter, const Truth& truth) const;
  std::size_t transmitters() const { return transmitters_.size(); }
  /// BSSID, or UUID/MAJOR/MINOR.
  const std::string& name(std::size_t transmitter) const { return transmitters_[transmitter].name; }

 private:
  struct Transmitter {
    std::string name{};
    bool wifi = false;
    std::string uuid{};
    int major = 0;
    int minor = 0;
    building::Point at{};
    double level = 0.0;
    double height_m = 0.0;
    double power_1m_dbm = 0.0;
    int frequency_mhz = 0;
    SpatialField shadowing;
    milliseconds next{0};               ///< next beacon, or next pass of its Wi-Fi channel
    std::optional<WifiReading> last{};  ///< Wi-Fi: latest reading
  };

  void add(const building::Landmark& landmark);
  std::optional<int> receive(std::size_t transmitter, const Truth& truth, double noise_db, double sensitivity_dbm);
  void hear(const Truth& truth);
  WifiScan scan(milliseconds t);

  const building::Building& building_;
  RadioOptions options_;
  std::uint64_t seed_;
  Random random_;
  std::vector<Transmitter> transmitters_{};
  std::vector<BeaconReading> heard_beacons_{};
  milliseconds next_scan_{0};
  milliseconds next_batch_{0};
};

}  // namespace fiona::simulator
