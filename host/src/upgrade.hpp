#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "fiona/wire.pb.h"

namespace fiona::host {

/// Whether what is to take the place of an instance, or has taken it, says what is expected of it: something on each of
/// the ports that it is heard on. Of a port that the one before says nothing on, nothing is expected either.
class Deliveries {
 public:
  /// One port. The taps tell what it says, and what the one before does; 0: that is not looked at.
  struct Pair {
    std::string port;
    std::uint64_t tap = 0;
    std::uint64_t before = 0;
  };
  /// `name` is the instance's in the events of its process.
  Deliveries(std::string name, std::vector<Pair> pairs) : name_(std::move(name)), pairs_(std::move(pairs)) {}

  /// [one thread at a time] Something has happened in the system: why it is not fit, once that is known.
  std::optional<std::string> note(const wire::GroupMessage& event);
  /// All has been heard that may be expected.
  bool all() const;
  /// What is missing when the time is over; none: nothing.
  std::optional<std::string> missing() const;

 private:
  const std::string name_;
  const std::vector<Pair> pairs_;
  std::map<std::uint64_t, std::uint64_t> heard_;  ///< messages, by tap
};

/// What an instance beside the one that serves is called in events: no instance has such a name.
inline std::string beside_name(const std::string& instance) { return "/" + instance; }

/// Before an upgrade is taken for good, where nobody says otherwise.
inline constexpr double kUpgradeWatch_ms = 10'000;
inline constexpr double kMostUpgradeWatch_ms = 3'600'000;
/// In which the new version must be in its mode: the one that serves goes on meanwhile, and nothing else is changed.
inline constexpr double kUpgradeStart_ms = 4'500;
/// In which it must have said something; more where its services have a longer period.
inline constexpr double kDelivers_ms = 2'000;
inline constexpr double kMostDelivers_ms = 10'000;
/// What an old version was asked before its clients went may take so long: the deadline that calls have by default.
inline constexpr std::chrono::seconds kDrain{2};

}  // namespace fiona::host
