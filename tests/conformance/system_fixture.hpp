#pragma once

#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "../temporary_directory.hpp"
#include "os/process.hpp"
#include "system.hpp"

namespace fiona::conformance {

/// Between which places the wires of a test run.
enum class Transport { Process, Ipc, Tcp };
std::string to_string(Transport transport);
void PrintTo(Transport transport, std::ostream* out);

/// "nav.location".
control::PortName port_name(const std::string& text);
/// "a=1 b=text" as arguments; a word without = is passed over.
void add_arguments(const std::string& text, google::protobuf::RepeatedPtrField<control::Argument>& list);

using tests::TemporaryDirectory;

/// A fiona.test.Sample as the test sees it. The test must not link the message itself: the plugin brings it, and
/// protobuf allows a file once per process. Also the value of a probe: a number as `value`, a text as `payload`.
class SeenSample {
 public:
  SeenSample() = default;
  explicit SeenSample(const google::protobuf::Message& sample);
  bool has_value = false;  ///< of a probe; false: there is none yet
  std::string unit;        ///< of a probe
  std::uint64_t sequence = 0;
  std::uint64_t opening = 0;  ///< of the tap
  std::uint64_t counted = 0;  ///< by the tap since it was opened, from 1
  std::uint64_t skipped = 0;  ///< by the tap so far
  std::uint64_t number() const { return number_; }
  std::int64_t sent_ns() const { return sent_ns_; }
  double value() const { return value_; }
  const std::string& payload() const { return payload_; }

 private:
  std::uint64_t number_ = 0;
  std::int64_t sent_ns_ = 0;
  double value_ = 0;
  std::string payload_;
};

/// A host in a process of its own, as `fiona run --listen` starts it, that lets the test's system lead it.
class OtherHost {
 public:
  struct Choice {
    std::string listen = "127.0.0.1:0";
    bool plugins = true;       ///< may load the test's library
    std::string network = "";  ///< a network namespace; empty: the test's own
    std::string registry = "";
  };
  /// Its keys and sockets go below `directory`.
  OtherHost(const std::filesystem::path& directory, const std::string& name) : OtherHost(directory, name, Choice()) {}
  OtherHost(const std::filesystem::path& directory, const std::string& name, Choice choice);

  /// To be given to the system that leads it, whose keys are in `keys`; it is let in under the directory's name.
  host::HostOptions led_from(const std::filesystem::path& keys) const;
  /// "127.0.0.1:41234"
  const std::string& address() const { return address_; }
  const std::filesystem::path& keys() const { return keys_; }
  pid_t process() const { return process_->id(); }
  /// What it has said on standard error so far.
  std::string said() const;
  /// Again, at the same port.
  void restart();
  void restart(Choice choice);

 private:
  void start();

  const std::filesystem::path directory_;
  const std::string name_;
  Choice choice_;
  const std::filesystem::path keys_;
  std::string address_;
  std::unique_ptr<os::ChildProcess> process_;
};

/// How a change of mode, or a call, ended, once it has.
struct LaterAnswer {
  std::atomic<bool> ended{false};
  control::Reply reply;  ///< to be read once it has ended
};

/// A running system in the test's process, with the test's components loaded as plugins. Provider and client live in
/// `main`; over ipc each in a group of its own, "near" and "far"; over tcp the client lives on another host, "far".
class RunningSystem {
 public:
  explicit RunningSystem(Transport transport = Transport::Process);
  /// With so many threads in each process, and this patience with a virtual clock.
  RunningSystem(std::size_t threads, std::chrono::milliseconds standstill);
  /// Leads these hosts, or listens for one.
  explicit RunningSystem(const host::HostOptions& hosts);
  /// Ends groups that hang, as a host does; other systems here leave alone those that a test has stopped.
  struct EndsHungGroups {};
  RunningSystem(const host::HostOptions& hosts, EndsHungGroups);
  /// The same, and each group may take no more than this.
  RunningSystem(EndsHungGroups, os::Limits limits);
  /// Starts again groups that have ended, as a host does; other systems here leave them as they are.
  struct RestartsGroups {};
  explicit RunningSystem(RestartsGroups);
  RunningSystem(const host::HostOptions& hosts, RestartsGroups);

  /// Loads "source", "sink", … as `name`; "neutral a=1 b=2": in mode neutral, with these parameters.
  void load_provider(const std::string& component, const std::string& name, const std::string& parameters = "");
  void load_client(const std::string& component, const std::string& name, const std::string& parameters = "");
  /// Into a group of this name.
  void load_in(const std::string& group, const std::string& component, const std::string& name,
               const std::string& parameters = "");
  /// Where clients are loaded; the answer comes once it has started.
  std::shared_ptr<LaterAnswer> begin_load_client(const std::string& component, const std::string& name,
                                                 const std::string& parameters = "");
  control::Done wire(const std::string& client, const std::string& provider, std::uint32_t every = 1);
  /// To the first of these that is fit. A negative hold time: the usual one.
  control::Done wire_to_several(const std::string& client, const std::vector<std::string>& providers,
                                double hold_ms = -1, std::uint32_t every = 1);
  void unwire(const std::string& client);
  void set(const std::string& instance, const std::string& parameters);
  void state(const std::string& instance, const std::string& mode);
  /// Asks for a change of mode; the answer comes later.
  std::shared_ptr<LaterAnswer> begin_state(const std::string& instance, const std::string& mode, double within_ms = 0);
  /// Calls a port or trigger by hand and waits for the end.
  control::Called call(const std::string& target, const std::string& arguments = "", double within_ms = 0);
  /// The same; the answer comes later.
  std::shared_ptr<LaterAnswer> begin_call(const std::string& target, const std::string& arguments, double within_ms);
  void unload(const std::string& instance);
  /// The newest line of the log that an instance has written and that begins so; empty: there is none.
  std::string logged(const std::string& instance, const std::string& begin);
  host::System& system() { return system_; }
  /// Where its processes listen.
  const std::filesystem::path& directory() const { return directory_.path; }
  /// Lets the clock pass, and returns how that ended.
  control::Reply let_pass(std::chrono::milliseconds time);
  /// Passes on what the groups have said, waiting for it so long at most.
  void serve_groups(std::chrono::milliseconds most);

  /// Watches a port that pushes test samples; `wait_for` looks at what it has put since.
  std::uint64_t watch(const std::string& port, control::Watch terms = {});
  /// The first sample of the watched port, not looked at before, that `fits`; fails the test after `deadline`.
  SeenSample wait_for(std::uint64_t watch, const std::function<bool(const SeenSample&)>& fits,
                      std::chrono::milliseconds deadline = std::chrono::seconds(30));
  /// All samples so far that `wait_for` has not passed.
  std::vector<SeenSample> take(std::uint64_t watch);
  control::PortStatus port(const std::string& name);
  control::InstanceStatus instance(const std::string& name);
  /// Another host as this one sees it.
  control::HostStatus host(const std::string& name);
  /// Waits until it has joined.
  void join(const std::string& name);
  control::GroupStatus group(const std::string& name);
  /// Where `load_provider` loads.
  std::string providers_group() const { return transport_ == Transport::Ipc ? "near" : "main"; }
  /// Of the client's side, where that is not the test's own: the group, or the other host.
  pid_t far_process();
  /// Where that is the other host: another run of it.
  void start_far_host_anew() { other_->restart(); }
  /// A probe, read once.
  SeenSample read(const std::string& probe);
  /// Waits until the tap has ended; why.
  control::Failure end_of(std::uint64_t watch);
  /// Polls `fits` until it holds; fails the test after `deadline`.
  void eventually(const std::string& what, const std::function<bool()>& fits,
                  std::chrono::milliseconds deadline = std::chrono::seconds(30));

 private:
  static control::Load load_of(const std::string& group, const std::string& component, const std::string& name,
                               const std::string& parameters);
  std::string clients_group() const { return transport_ == Transport::Process ? "" : "far"; }
  void keep(const wire::GroupMessage& event);
  SeenSample seen(const wire::Tapped& tapped);

  RunningSystem(Transport transport, const std::string& other, host::System::Options options);
  host::System::Options completed(host::System::Options options) const;

  const Transport transport_;
  const TemporaryDirectory directory_;
  std::unique_ptr<OtherHost> other_;
  std::mutex mutex_;
  std::map<std::uint64_t, std::vector<SeenSample>> seen_;
  std::map<std::uint64_t, std::size_t> passed_;
  std::map<std::uint64_t, control::Failure> ended_;
  std::vector<std::pair<std::string, std::string>> log_;  ///< who, and what
  host::System system_;                                   ///< last: its threads use the rest until it has ended
};

/// From now on the groups of all systems that run over ipc are copies of one process, which ends with this one: to
/// start it takes a sanitizer longer than many a test.
void share_group_template();

/// What most tests run in: a system whose wires go over the transport that the test is run for.
class OverTransports : public ::testing::TestWithParam<Transport> {
 protected:
  RunningSystem system{GetParam()};
};

}  // namespace fiona::conformance

/// Runs the tests of a suite over these transports, and names each run after its own.
#define FIONA_OVER(suite, ...)                                          \
  INSTANTIATE_TEST_SUITE_P(Over, suite, ::testing::Values(__VA_ARGS__), \
                           [](const auto& run) { return to_string(run.param); })
#define FIONA_OVER_EVERY_TRANSPORT(suite) FIONA_OVER(suite, Transport::Process, Transport::Ipc, Transport::Tcp)
