// Promise R11: a thousand components, in groups of ten, on a real host. It starts, is listed, is rewired, loses groups
// to SIGKILL, and costs little while it rests. FIONA_COMPONENTS sets how many they are.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <iostream>
#include <map>
#include <random>
#include <set>
#include <sstream>

#include <fmt/format.h>

#include "campaign.hpp"
#include "control_client.hpp"
#include "fiona/modes.hpp"
#include "host_process.hpp"
#include "os/process.hpp"

namespace fiona::conformance {
namespace {

constexpr int kGroupSize = 10;
constexpr double kStart_s = 30;
constexpr double kAnswer_ms = 200;
constexpr double kRestart_ms = 500;
constexpr double kIdle_cores = 0.1;
constexpr double kMemory_mib = 2560;  // of a thousand
constexpr double kComponents = 1000;

double milliseconds_since(std::int64_t begun_ns) { return static_cast<double>(now_ns() - begun_ns) / 1e6; }

double proportional_mib(pid_t process) {
  std::ifstream file(fmt::format("/proc/{}/smaps_rollup", process));
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("Pss:")) return std::stod(line.substr(4)) / 1024;
  }
  throw Error(ErrorCode::NotFound, fmt::format("/proc/{}/smaps_rollup says no Pss", process));
}

double processor_s(pid_t process) {
  std::ifstream file(fmt::format("/proc/{}/stat", process));
  std::string text((std::istreambuf_iterator<char>(file)), {});
  std::istringstream rest(text.substr(std::min(text.size(), text.rfind(')') + 1)));
  std::string word;
  for (int field = 3; field <= 13; ++field) rest >> word;  // proc(5): 14 and 15 are utime and stime
  double user = 0, kernel = 0;
  rest >> user >> kernel;
  return (user + kernel) / static_cast<double>(::sysconf(_SC_CLK_TCK));
}

class Thousand : public testing::Test {
 protected:
  static std::string group_of(int i) { return fmt::format("g{}", i / kGroupSize); }
  static std::string pacer(int i) { return fmt::format("pacer{}", i); }
  static std::string stopwatch(int i) { return fmt::format("stopwatch{}", i); }
  /// Half are pacers; each has its stopwatch in the group opposite, so that every wire crosses.
  int pairs() const { return components / 2; }
  int stopwatch_place(int i) const { return (i + pairs() / 2) % pairs(); }

  void load(control::Transact& changes, const std::string& component, const std::string& name, int place,
            const std::string& parameters) const {
    control::Load& load = *changes.add_changes()->mutable_load();
    load.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
    load.set_instance(name);
    load.set_group(group_of(2 * place));
    add_arguments(parameters, *load.mutable_parameters());
  }
  static void wire(control::Transact& changes, const std::string& client, const std::string& provider) {
    auto& wire = *changes.add_changes()->mutable_wire();
    *wire.mutable_client() = port_name(client + ".samples");
    *wire.mutable_provider() = port_name(provider + ".samples");
  }
  void start() {
    for (int i = 0; i < pairs(); ++i) {
      control::Request request;
      auto& changes = *request.mutable_transact();
      load(changes, "pacer", pacer(i), i, "period_ms=1000 count=1000000");
      load(changes, "stopwatch", stopwatch(i), stopwatch_place(i), "count=1000000");
      wire(changes, stopwatch(i), pacer(i));
      client.call(request);
    }
  }
  control::System look() {
    control::Request question;
    question.mutable_snapshot();
    return client.call(question).system();
  }
  static bool is_up(const control::InstanceStatus& instance) {
    return instance.mode() == kModeActive &&
           std::all_of(instance.ports().begin(), instance.ports().end(), [](const auto& port) {
             return port.direction() != REQUIRES || port.connection() == control::CONNECTED;
           });
  }
  void await_all_up(const std::string& after) {
    const std::int64_t begun_ns = now_ns();
    while (true) {
      const auto system = look();
      if (std::all_of(system.instances().begin(), system.instances().end(), is_up)) return;
      ASSERT_LT(milliseconds_since(begun_ns), 30'000) << "not all are active and connected " << after;
      rest(std::chrono::milliseconds(10));
    }
  }
  void rest(std::chrono::milliseconds time) {
    reactor.run_until([] { return false; }, std::chrono::steady_clock::now() + time);
  }
  std::vector<pid_t> all_processes() {
    std::vector<pid_t> all;
    const auto system = look();
    for (const auto& group : system.groups()) all.push_back(group.process());
    return all;
  }
  double console_ms() const {
    const std::int64_t begun_ns = now_ns();
    os::ChildProcess console(os::program_directory() / "fiona", {"--at", "unix:" + socket().string(), "ls"},
                             {{nothing.get(), 1}});
    pollfd end{console.descriptor(), POLLIN, 0};
    EXPECT_EQ(::poll(&end, 1, 10'000), 1) << "the console does not end";
    EXPECT_EQ(console.end(), "exited with code 0");
    return milliseconds_since(begun_ns);
  }
  /// How long until this group runs in another process, with all of its own active and connected again.
  double restart_ms(const std::string& name, pid_t before) {
    const std::int64_t begun_ns = now_ns();
    EXPECT_EQ(::kill(before, SIGKILL), 0);
    while (milliseconds_since(begun_ns) < 10'000) {
      const auto system = look();
      const auto group = std::find_if(system.groups().begin(), system.groups().end(),
                                      [&](const auto& one) { return one.name() == name; });
      const bool anew = group != system.groups().end() && group->alive() && group->process() != before;
      const bool up = std::all_of(system.instances().begin(), system.instances().end(),
                                  [&](const auto& one) { return one.group() != name || is_up(one); });
      if (anew && up) return milliseconds_since(begun_ns);
    }
    ADD_FAILURE() << name << " did not come back";
    return 0;
  }
  std::filesystem::path socket() const { return directory.path / "host.sock"; }

  const bool full = number_from("FIONA_COMPONENTS", 0) > 0;
  const int components =
      std::max(4 * kGroupSize, number_from("FIONA_COMPONENTS", 60)) / (2 * kGroupSize) * 2 * kGroupSize;
  const unsigned seed =
      static_cast<unsigned>(number_from("FIONA_SEED", static_cast<int>(std::random_device{}() % 1'000'000)));
  std::mt19937 random{seed};
  const TemporaryDirectory directory;
  console::Reactor reactor;
  console::HostProcess host{reactor,
                            {os::program_directory() / "fiona-host", socket(), "crowd", directory.path / "store"},
                            [](const std::string&) {}};
  console::ControlClient client{reactor, console::Endpoint{.socket = socket()}, std::chrono::seconds(60)};
  const os::Descriptor nothing{::open("/dev/null", O_WRONLY | O_CLOEXEC)};
};

TEST_F(Thousand, StartsIsListedRewiredAndLosesGroupsWithoutHarmToTheRest) {
  std::cout << fmt::format("seed {}, {} components in groups of {}\n", seed, components, kGroupSize);
  Pulse pulse;
  std::int64_t begun_ns = now_ns();
  start();
  await_all_up("after the start");
  const double start_s = milliseconds_since(begun_ns) / 1e3;
  std::cout << fmt::format("start {:.2f} s (bound {:.0f} s)\n", start_s, kStart_s);
  EXPECT_LE(start_s, allowed(kStart_s, full));

  double memory_mib = 0;
  for (const pid_t process : all_processes()) memory_mib += proportional_mib(process);
  std::cout << fmt::format("memory of all, PSS {:.0f} MiB (bound {:.0f} MiB for a thousand)\n", memory_mib,
                           kMemory_mib);
  if (!kKeepsWhatIsFreed) {
    EXPECT_LE(memory_mib, full ? kMemory_mib * components / kComponents : kMemory_mib);
  }

  Times answers;
  for (int i = 0; i < (full ? 200 : 20); ++i) answers.add(console_ms());
  std::cout << answers.text("fiona ls", kAnswer_ms) << "\n";
  EXPECT_LE(answers.longest(), allowed(kAnswer_ms, full) + pulse.longest_ms());

  Times rewires;
  for (int i = 0; i < pairs() / 5; ++i) {
    control::Request request;
    const int one = std::uniform_int_distribution<int>(0, pairs() - 1)(random);
    wire(*request.mutable_transact(), stopwatch(one), pacer((one + 1) % pairs()));
    begun_ns = now_ns();
    client.call(request);
    rewires.add(milliseconds_since(begun_ns));
  }
  std::cout << rewires.text("rewire", 250) << "\n";
  EXPECT_LE(rewires.longest(), allowed(250, full) + pulse.longest_ms());
  await_all_up("after the rewiring");

  std::map<std::string, pid_t> groups;
  const auto before = look();
  for (const auto& group : before.groups()) {
    if (group.name() != "main") groups[group.name()] = group.process();
  }
  const auto victims = static_cast<std::size_t>(components / kGroupSize / 2);
  Times restarts;
  std::set<std::string> killed;
  for (const auto& [name, process] : groups) {
    if (killed.size() == victims) break;
    restarts.add(restart_ms(name, process));
    killed.insert(name);
  }
  std::cout << restarts.text(fmt::format("a group of {} killed and back, with all its wires,", kGroupSize), kRestart_ms)
            << "\n";
  EXPECT_LE(restarts.longest(), allowed(kRestart_ms, full) + pulse.longest_ms());
  await_all_up("after the deaths");

  std::uint64_t missed = 0;
  const auto after = look();
  for (const auto& instance : after.instances()) {
    for (const auto& port : instance.ports()) missed += killed.contains(instance.group()) ? 0 : port.dropped();
  }
  EXPECT_EQ(missed, 0U) << "lost by those whose groups were not killed";
  EXPECT_TRUE(host.running());
}

TEST_F(Thousand, CostsLittleWhileItRests) {
  start();
  await_all_up("after the start");
  for (int i = 0; i < pairs(); ++i) {
    control::Request request;
    auto& state = *request.mutable_transact()->add_changes()->mutable_state();
    state.set_instance(pacer(i));
    state.set_mode("neutral");
    client.call(request);
  }
  const auto processes = all_processes();
  const auto used_s = [&] {
    double sum = 0;
    for (const pid_t process : processes) sum += processor_s(process);
    return sum;
  };
  const auto time = std::chrono::seconds(full ? 30 : 3);
  const double before_s = used_s();
  rest(time);
  const double cores = (used_s() - before_s) / std::chrono::duration<double>(time).count();
  std::cout << fmt::format("{} components at rest: {:.1f} % of a core (bound {:.0f} %)\n", components, 100 * cores,
                           100 * kIdle_cores);
  EXPECT_LE(cores, allowed(kIdle_cores, full));
}

}  // namespace
}  // namespace fiona::conformance
