// Promise R11: a thousand components, in groups of ten, on a real host. It starts, is listed, is rewired, loses groups
// to SIGKILL as promise R1 wants it, and costs little while it rests. FIONA_COMPONENTS sets how many they are.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <random>
#include <set>
#include <sstream>
#include <vector>

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
constexpr double kIdle_cores = 0.1;
constexpr double kMemory_mib = 2560;  // of a thousand
constexpr double kComponents = 1000;

double milliseconds_between(std::int64_t begun_ns, std::int64_t ended_ns) {
  return static_cast<double>(ended_ns - begun_ns) / 1e6;
}
double milliseconds_since(std::int64_t begun_ns) { return milliseconds_between(begun_ns, now_ns()); }

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

  static void load(control::Transact& changes, const std::string& component, const std::string& name,
                   const std::string& group, const std::string& parameters = "") {
    control::Load& load = *changes.add_changes()->mutable_load();
    load.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
    load.set_instance(name);
    load.set_group(group);
    add_arguments(parameters, *load.mutable_parameters());
  }
  static void wire(control::Transact& changes, const std::string& client, const std::string& provider,
                   const std::string& port = "samples") {
    auto& wire = *changes.add_changes()->mutable_wire();
    *wire.mutable_client() = port_name(client + "." + port);
    *wire.mutable_provider() = port_name(provider + "." + port);
  }
  void start() {
    for (int i = 0; i < pairs(); ++i) {
      control::Request request;
      auto& changes = *request.mutable_transact();
      load(changes, "pacer", pacer(i), group_of(2 * i), "period_ms=1000 count=1000000");
      load(changes, "stopwatch", stopwatch(i), group_of(2 * stopwatch_place(i)), "count=1000000");
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
             return port.direction() != REQUIRES || port.optional() || port.connection() == control::CONNECTED;
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
  control::PortStatus port(const std::string& instance, const std::string& port) {
    const auto system = look();
    for (const auto& one : system.instances()) {
      for (const auto& status : one.ports()) {
        if (one.name() == instance && status.name() == port) return status;
      }
    }
    throw Error(ErrorCode::NotFound, "no port " + instance + "." + port);
  }
  void await(const std::string& what, const std::function<bool()>& holds) {
    const std::int64_t begun_ns = now_ns();
    while (!holds()) {
      if (milliseconds_since(begun_ns) > 10'000) throw Error(ErrorCode::Unreachable, "never happened: " + what);
      rest(std::chrono::milliseconds(2));
    }
  }

  // ---- deaths
  Sighting testimony(const std::string& lookout, const std::string& manner = "") {
    control::Request request;
    *request.mutable_call()->mutable_target() = port_name(lookout + ".testify");
    add_arguments("manner=" + manner, *request.mutable_call()->mutable_arguments());
    const auto told = client.call(request).called();
    if (told.outcome() != "ok") throw Error(ErrorCode::Failed, lookout + ": " + told.outcome() + ", " + told.reason());
    return sighting_from(Told(told.result()).seen());
  }
  void await_sight(const std::string& lookout) {
    await(lookout + " sees", [&] { return testimony(lookout).sees; });
  }
  static void look_at(control::Transact& changes, const std::string& lookout, const std::string& station) {
    for (const std::string port : {"timed", "samples", "echo"}) wire(changes, lookout, station, port);
  }
  /// What must not notice that groups die, and who is to be told; all in groups that do not.
  void load_onlookers(const std::vector<std::string>& places) {
    const auto place = [&places](std::size_t i) { return places[i % places.size()]; };
    control::Request request;
    auto& changes = *request.mutable_transact();
    load(changes, "station", "sound", place(0));
    load(changes, "lookout", "witness", place(1), "asks_ms=10");
    look_at(changes, "witness", "sound");
    load(changes, "pacer", "beat", place(2), "period_ms=1 count=100000000");
    load(changes, "stopwatch", "measure", place(3), "count=100000000");
    wire(changes, "measure", "beat");
    load(changes, "lookout", "onlooker", place(4));
    client.call(request);
    await_sight("witness");
    await("traffic", [&] { return port("measure", "samples").messages() > 500; });
    calm_ms = worst_ms = port("measure", "samples").latency_p99_ms();
    testimony("witness", "forget");
  }
  /// Asks to be told when it has failed.
  std::uint64_t begin_watch(const std::string& instance, std::int64_t& failed_ns) {
    control::Request request;
    request.mutable_wait_mode()->set_instance(instance);
    request.mutable_wait_mode()->set_mode(std::string(kModeFailed));
    request.mutable_wait_mode()->set_within_ms(20'000);
    return client.begin(request, [&failed_ns](const control::Reply& reply) {
      EXPECT_TRUE(reply.has_met()) << reply.failure().what();
      failed_ns = now_ns();
    });
  }
  /// Kills a group, with a station in it that somebody looks at.
  void die(const std::string& group, pid_t process) {
    control::Request request;
    load(*request.mutable_transact(), "station", "station", group);
    look_at(*request.mutable_transact(), "onlooker", "station");
    client.call(request);
    await_sight("onlooker");
    std::int64_t failed_ns = 0;
    const std::uint64_t watch = begin_watch("station", failed_ns);
    testimony("onlooker", "forget");  // answered behind what was asked before
    const Passing passing(process);
    ASSERT_EQ(::kill(process, SIGKILL), 0);
    await("it is seen that it died", [&] { return failed_ns > 0 && passing.at_ns() > 0; });
    client.forget(watch);
    seen.add(std::max(0.0, milliseconds_between(passing.at_ns(), failed_ns)));
    await(group + " is back", [&] { return is_back(group, process); });
    back.add(milliseconds_since(passing.at_ns()));
    await_sight("onlooker");
    const std::int64_t told_ns = testimony("onlooker").lost_ns;
    EXPECT_GT(told_ns, 0) << "it was not told";
    told.add(std::max(0.0, milliseconds_between(passing.at_ns(), told_ns)));
    worst_ms = std::max(worst_ms, port("measure", "samples").latency_p99_ms());
    unload("station");
  }
  void unload(const std::string& instance) {
    control::Request request;
    request.mutable_transact()->add_changes()->mutable_unload()->set_instance(instance);
    client.call(request);
  }
  /// In another process, with all of its own active and connected again.
  bool is_back(const std::string& name, pid_t before) {
    const auto system = look();
    const auto group = std::find_if(system.groups().begin(), system.groups().end(),
                                    [&](const auto& one) { return one.name() == name; });
    return group != system.groups().end() && group->alive() && group->process() != before &&
           std::all_of(system.instances().begin(), system.instances().end(),
                       [&](const auto& one) { return one.group() != name || is_up(one); });
  }
  void expect_others_noticed_nothing(const std::set<std::string>& killed, const Pulse& pulse) {
    const Sighting witness = testimony("witness");
    expect_all_answered(witness);
    std::uint64_t missed = 0;
    const auto system = look();
    for (const auto& instance : system.instances()) {
      // A lookout drops what is too old for it.
      const bool is_lookout = instance.name() == "onlooker" || instance.name() == "witness";
      for (const auto& port : instance.ports())
        missed += is_lookout || killed.contains(instance.group()) ? 0 : port.dropped();
    }
    EXPECT_EQ(missed, 0U) << "lost by those whose groups were not killed";
    std::cout << fmt::format(
        "others: {} questions, {} messages lost; p99 of a message {:.2f} ms in calm, {:.2f} ms at worst (bound "
        "+ {:.0f} ms); the machine stood still for {:.0f} ms at most\n",
        witness.asked, missed, calm_ms, worst_ms, kOthersLater_ms, pulse.longest_ms());
    EXPECT_LE(worst_ms, calm_ms + allowed(kOthersLater_ms, full) + pulse.longest_ms());
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
  Times seen, told, back;
  double calm_ms = 0, worst_ms = 0;  ///< p99 of what others send each other
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

  std::map<std::string, pid_t> victims;
  std::vector<std::string> others;
  const auto before = look();
  for (const auto& group : before.groups()) {
    if (group.name() == "main") continue;
    if (victims.size() < static_cast<std::size_t>(components / kGroupSize / 2)) {
      victims[group.name()] = group.process();
    } else {
      others.push_back(group.name());
    }
  }
  load_onlookers(others);
  std::set<std::string> killed;
  for (const auto& [name, process] : victims) {
    die(name, process);
    ASSERT_FALSE(HasFatalFailure());
    killed.insert(name);
  }
  expect_within("death seen", kDeathSeen_ms, seen, full, pulse);
  expect_within("who looked at it told", kDeathTold_ms, told, full, pulse);
  expect_within(fmt::format("a group of {} back, with all its wires", kGroupSize), kBackAfterDeath_ms, back, full,
                pulse);
  expect_others_noticed_nothing(killed, pulse);
  unload("onlooker");
  await_all_up("after the deaths");
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
