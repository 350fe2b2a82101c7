#include "console_answer.hpp"

#include <fcntl.h>
#include <poll.h>

#include <algorithm>
#include <chrono>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "control_client.hpp"
#include "host_process.hpp"
#include "os/process.hpp"
#include "system_fixture.hpp"

namespace fiona::bench {
namespace {

using Steady = std::chrono::steady_clock;

constexpr int kPublishers = 20;
constexpr int kIdle = 60;
constexpr double kRate_hz = 1000;
constexpr int kAsked = 200;
constexpr std::chrono::milliseconds kPause{50};  // or the consoles themselves keep a core busy

double seconds_since(Steady::time_point begun) { return std::chrono::duration<double>(Steady::now() - begun).count(); }

control::Load& add_load(control::Transact& changes, const std::string& component, const std::string& name,
                        const std::string& parameters) {
  control::Load& load = *changes.add_changes()->mutable_load();
  load.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
  load.set_instance(name);
  conformance::add_arguments(parameters, *load.mutable_parameters());
  return load;
}

/// 20 publishers, which come to 1 kHz and more between their timer's wake-ups, a subscriber of each, and 60 instances
/// that do nothing.
control::Request hundred_instances() {
  control::Request request;
  auto& changes = *request.mutable_transact();
  for (int i = 0; i < kPublishers; ++i) {
    const std::string number = std::to_string(i);
    add_load(changes, "pacer", "pacer" + number, "payload=64 period_ms=0.8 count=10000000");
    add_load(changes, "stopwatch", "stopwatch" + number, "count=10000000");
    auto& wire = *changes.add_changes()->mutable_wire();
    *wire.mutable_client() = conformance::port_name("stopwatch" + number + ".samples");
    *wire.mutable_provider() = conformance::port_name("pacer" + number + ".samples");
  }
  for (int i = 0; i < kIdle; ++i) add_load(changes, "mover", "mover" + std::to_string(i), "").set_mode("neutral");
  return request;
}

class BusyHost {
 public:
  BusyHost()
      : host_(reactor_, {os::program_directory() / "fiona-host", socket(), "bench", directory_.path / "store"}, {}),
        client_(reactor_, console::Endpoint{.socket = socket()}, std::chrono::seconds(30)),
        nothing_(::open("/dev/null", O_WRONLY | O_CLOEXEC)) {
    client_.call(hundred_instances());
  }

  /// The 99th percentile of `fiona LINE`, in milliseconds.
  double p99_ms(const std::vector<std::string>& line) {
    const std::uint64_t before = moved();
    const auto begun = Steady::now();
    std::vector<double> times;
    for (int i = 0; i < kAsked; ++i) {
      times.push_back(1e3 * time_of(line));
      std::this_thread::sleep_for(kPause);
    }
    const double rate_hz = static_cast<double>(moved() - before) / seconds_since(begun);
    if (rate_hz < kPublishers * kRate_hz) {
      throw std::runtime_error("the host moves " + std::to_string(static_cast<int>(rate_hz)) +
                               " messages a second only");
    }
    std::sort(times.begin(), times.end());
    return times[times.size() * 99 / 100];
  }

 private:
  std::filesystem::path socket() const { return directory_.path / "host.sock"; }

  double time_of(const std::vector<std::string>& line) const {
    std::vector<std::string> words{"--at", "unix:" + socket().string()};
    words.insert(words.end(), line.begin(), line.end());
    const auto begun = Steady::now();
    os::ChildProcess console(os::program_directory() / "fiona", words, {{nothing_.get(), 1}});
    pollfd end{console.descriptor(), POLLIN, 0};
    if (::poll(&end, 1, 10'000) != 1) throw std::runtime_error("the console does not end");
    const double seconds = seconds_since(begun);
    if (const std::string how = console.end(); how != "exited with code 0")
      throw std::runtime_error("the console " + how);
    return seconds;
  }

  std::uint64_t moved() {
    control::Request question;
    question.mutable_snapshot();
    const control::System system = client_.call(question).system();
    std::uint64_t messages = 0;
    for (const auto& instance : system.instances()) {
      for (const auto& port : instance.ports()) {
        if (instance.name().starts_with("stopwatch") && port.name() == "samples") messages += port.messages();
      }
    }
    return messages;
  }

  const conformance::TemporaryDirectory directory_;
  console::Reactor reactor_;
  console::HostProcess host_;
  console::ControlClient client_;
  const os::Descriptor nothing_;
};

}  // namespace

double ls_ms() { return BusyHost().p99_ms({"ls"}); }

double completion_ms() { return BusyHost().p99_ms({"complete", "wire stopwatch7."}); }

}  // namespace fiona::bench
