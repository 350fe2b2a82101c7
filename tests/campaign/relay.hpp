#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <map>
#include <mutex>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "cable.hpp"
#include "os/descriptor.hpp"

namespace fiona::conformance {

/// A network namespace behind a relay that does with packets what long and bad ways do: two TUN devices, and a thread
/// that carries packets from one to the other when their time has come.
class Relay : public Network {
 public:
  struct Weather {
    double delay_ms = 0;
    double jitter_ms = 0;  ///< more or less than that
    double late = 0;       ///< the share of packets that are overtaken: they take 30 ms more
    double twice = 0;      ///< the share of packets that come twice
  };
  /// What chance does follows from the seed.
  explicit Relay(unsigned seed);
  ~Relay();
  void set(const Weather& weather);
  /// Packets carried, and how many of them came twice, late, or not at all because too many were under way.
  struct Counts {
    std::uint64_t carried = 0, twice = 0, late = 0, lost = 0;
  };
  Counts counts();

 private:
  using Clock = std::chrono::steady_clock;
  struct Packet {
    int to;
    std::vector<char> bytes;
  };
  void open_devices();
  void carry();
  void take(int from, int to);
  void plan(int to, std::vector<char> bytes);
  void deliver_due();
  double by_chance() { return std::uniform_real_distribution<double>(0, 1)(random_); }

  os::Descriptor here_device_;
  os::Descriptor there_device_;
  std::mutex mutex_;
  Weather weather_;
  Counts counts_;
  std::mt19937 random_;
  std::multimap<Clock::time_point, Packet> under_way_;
  std::map<int, Clock::time_point> newest_;  ///< by device: packets that are not late stay in order
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

}  // namespace fiona::conformance
