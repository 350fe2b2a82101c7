#pragma once

#include <google/protobuf/dynamic_message.h>
#include <google/protobuf/message.h>
#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "../pulse.hpp"
#include "os/descriptor.hpp"
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

/// What a trigger of a component returned, of a type that the test does not link, with the files that describe it.
class Told {
 public:
  explicit Told(const control::Sample& sample);
  Seen seen() const { return Seen(*object_); }

 private:
  google::protobuf::DescriptorPool pool_{google::protobuf::DescriptorPool::generated_pool()};
  google::protobuf::DynamicMessageFactory factory_{&pool_};
  std::unique_ptr<google::protobuf::Message> object_;
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
Sighting sighting_from(const Seen& testimony);
Sighting sighting(RunningSystem& system, const std::string& lookout);
/// The same, and it begins anew.
Sighting take_sighting(RunningSystem& system, const std::string& lookout);

using Steady = std::chrono::steady_clock;
std::int64_t now_ns();
/// Lets the system work for so long.
void let_be(RunningSystem& system, std::chrono::milliseconds time);
/// What a short form allows where a full one, which has the machine for itself, asks for `bound`.
double allowed(double bound, bool in_full);

using tests::Pulse;

/// When a process ends, as the kernel tells it.
class Passing {
 public:
  explicit Passing(pid_t process);
  ~Passing() { watch_.join(); }
  std::int64_t at_ns() const { return at_ns_; }  ///< 0: not yet

 private:
  const os::Descriptor process_;
  std::atomic<std::int64_t> at_ns_{0};
  std::thread watch_;
};

/// What a death may do: promise R1.
constexpr double kDeathSeen_ms = 50;
constexpr double kDeathTold_ms = 200;
constexpr double kBackAfterDeath_ms = 500;
constexpr double kOthersLater_ms = 5;

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
/// Prints them, and expects that the longest is within the bound, but for what the machine stood still.
void expect_within(const std::string& what, double bound_ms, const Times& times, bool in_full, const Pulse& pulse);
/// Each question that it has asked since it was told to forget is answered, or still open.
void expect_all_answered(const Sighting& seen);

}  // namespace fiona::conformance
