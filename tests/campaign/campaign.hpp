#pragma once

#include <google/protobuf/message.h>
#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "system_fixture.hpp"

namespace fiona::conformance {

/// How much of something a campaign asks for, from the environment.
int number_from(const char* variable, int otherwise);

/// Rounds after which all processes have what they need, and what they use must stay.
constexpr int kWarmUp = 50;
/// Of what a lookout watches: what is older is nothing of now.
constexpr double kTwoPeriods_ms = 40;
/// What reading the clock of another host may be off, beside half of a round trip: promise R25.
constexpr double kClockError_ms = 10;
/// As AddressSanitizer does, to tell of uses after it.
constexpr bool kKeepsWhatIsFreed = FIONA_SANITIZED;

/// What all processes of the test hold.
struct Holdings {
  long descriptors = 0;
  long sockets = 0;  ///< of the descriptors
  long threads = 0;
  double resident_mib = 0;  ///< other than pages of files, which come and go as they are read, and what is shared
  double shared_mib = 0;    ///< memory that several processes have, each its part
  double memory_mib() const { return resident_mib + shared_mib; }
};

/// Throws Error where one of them is not there.
Holdings holdings(const std::vector<pid_t>& processes);
/// All of the system's, also those of the host that it leads, which tells nobody their numbers. Throws Error where one
/// of its groups has none.
std::vector<pid_t> processes(RunningSystem& system);

/// The fields of a message of which the test does not link the type.
class Seen {
 public:
  Seen(const google::protobuf::Message& message) : message_(message) {}  // NOLINT: reads like the message
  std::uint64_t number(const char* name) const { return reflect().GetUInt64(message_, field(name)); }
  std::int64_t fixed(const char* name) const { return reflect().GetInt64(message_, field(name)); }
  bool flag(const char* name) const { return reflect().GetBool(message_, field(name)); }
  double real(const char* name) const { return reflect().GetDouble(message_, field(name)); }
  std::vector<std::uint64_t> numbers(const char* name) const {
    std::vector<std::uint64_t> all;
    for (int i = 0; i < reflect().FieldSize(message_, field(name)); ++i)
      all.push_back(reflect().GetRepeatedUInt64(message_, field(name), i));
    return all;
  }
  std::vector<Seen> messages(const char* name) const {
    std::vector<Seen> all;
    for (int i = 0; i < reflect().FieldSize(message_, field(name)); ++i)
      all.emplace_back(reflect().GetRepeatedMessage(message_, field(name), i));
    return all;
  }

 private:
  const google::protobuf::Reflection& reflect() const { return *message_.GetReflection(); }
  const google::protobuf::FieldDescriptor* field(const char* name) const {
    return message_.GetDescriptor()->FindFieldByName(name);
  }
  const google::protobuf::Message& message_;
};

/// What an instance of the test's components says when it is asked: `ask(system, "w1.testify")`.
std::shared_ptr<google::protobuf::Message> ask(RunningSystem& system, const std::string& trigger,
                                               const std::string& arguments = "");

/// What a lookout has seen so far; steady times in nanoseconds.
struct Sighting {
  std::int64_t seen_ns = 0, blank_ns = 0, lost_ns = 0, last_ns = 0;
  bool sees = false;
  double oldest_shown_ms = 0, oldest_heard_ms = 0, longest_over_ms = 0;
  std::uint64_t heard = 0, asked = 0, open = 0;
  std::vector<std::uint64_t> outcomes;
};
Sighting sighting(RunningSystem& system, const std::string& lookout);
/// The same, and it begins anew.
Sighting take_sighting(RunningSystem& system, const std::string& lookout);

using Steady = std::chrono::steady_clock;
std::int64_t now_ns();
/// Lets the system work for so long.
void let_be(RunningSystem& system, std::chrono::milliseconds time);
/// What a short form allows where a full one, which has the machine for itself, asks for `bound`.
double allowed(double bound, bool in_full);

/// How long the machine has kept a thread waiting that wanted to run: what comes later than that by no fault of ours.
class Pulse {
 public:
  Pulse();
  ~Pulse();
  double longest_ms() const { return static_cast<double>(longest_ns_.load()) / 1e6; }

 private:
  std::atomic<std::int64_t> longest_ns_{0};
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

/// Durations of one kind, in milliseconds.
class Times {
 public:
  void add(double ms) { all_.push_back(ms); }
  std::size_t count() const { return all_.size(); }
  double longest() const;
  /// "kill 12 times: p50 3.1, p99 8.0, longest 9.1 ms (bound 300 ms)"
  std::string text(const std::string& what, double bound_ms) const;

 private:
  std::vector<double> all_;
};

}  // namespace fiona::conformance
