// What ends a call that waits when its provider dies, stands still, hangs or is cut off, and how soon
// (docs/patterns.md, the table of pending calls; the bounds are those of docs/architecture.md, Supervision).
#include <gtest/gtest.h>
#include <signal.h>

#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "cable.hpp"
#include "campaign.hpp"
#include "evidence.hpp"
#include "fiona/result.hpp"
#include "supervised_host.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

constexpr double kDies_ms = 200;
/// When a piece of work began, and that it is too long, is seen at a look, every 100 ms each, of which ten in a row may
/// come late by one.
constexpr double kSticks_ms = 1000 + 3 * 100;
constexpr double kStops_ms = 1000;
constexpr double kGone_ms = 2500;
constexpr double kSilent_ms = 1500;

/// For how long somebody on this machine has waited for a processor, of all time; none: its kernel does not tell.
std::optional<double> contention_ms() {
  const std::string text = content_of("/proc/pressure/cpu");
  const auto total = text.find("total=");
  if (total == std::string::npos) return std::nullopt;
  return std::stod(text.substr(total + 6)) / 1e3;
}

struct Moment {
  std::int64_t at_ns = now_ns();
  std::optional<double> contention = contention_ms();
};

/// What a bound is on this machine, since then: it is not held to what it had no processor for, nor, where nothing
/// tells of that or a sanitizer makes everything slower, to the bound itself.
double told_within(double bound_ms, const Moment& since) {
  const double excuse_ms = since.contention ? *contention_ms() - *since.contention : 0;
  return allowed(bound_ms, since.contention && !FIONA_SANITIZED) + excuse_ms;
}

/// Where the providers live; the caller is in `main` of the test's process.
enum class Place { Main, Group, OtherHost, GroupOfOtherHost };
std::string to_string(Place place) {
  return place == Place::Main        ? "Process"
         : place == Place::Group     ? "Ipc"
         : place == Place::OtherHost ? "Tcp"
                                     : "Tcp_Group";
}
void PrintTo(Place place, std::ostream* out) { *out << to_string(place); }

#define FIONA_OVER_PLACES(suite, ...)                                   \
  INSTANTIATE_TEST_SUITE_P(Over, suite, ::testing::Values(__VA_ARGS__), \
                           [](const auto& run) { return to_string(run.param); })
#define FIONA_OVER_EVERY_PLACE(suite) \
  FIONA_OVER_PLACES(suite, Place::Main, Place::Group, Place::OtherHost, Place::GroupOfOtherHost)

class LostProvider : public testing::TestWithParam<Place> {
 protected:
  void SetUp() override { set_up({}); }
  void TearDown() override {
    running.reset();
    other.reset();
  }
  void set_up(OtherHost::Choice choice) {
    if (away()) other = std::make_unique<OtherHost>(directory.path, "far", std::move(choice));
    const auto hosts = other ? other->led_from(directory.path / "test") : host::HostOptions{};
    running = std::make_unique<RunningSystem>(hosts, RunningSystem::EndsHungGroups());
    if (other) system().join("far");
    system().load_in("", "caller", "caller", "deadline_ms=100000");
    outcomes = system().watch("caller.outcome");
    load("source", "quiet", "neutral period_ms=1 count=1");
    load("source", "ringer");
    load("answerer", "answerer");
    load("sink", "sink");
    system().wire("caller.samples", "quiet.newest");
    system().wire("caller.echo", "answerer.echo");
    system().wire("caller.bell", "ringer.bell");
    system().wire("caller.orders", "sink.orders");
    ASSERT_EQ(outcome_of(begin("activate", "every=0")), Outcome::Ok);
  }
  RunningSystem& system() { return *running; }
  static bool away() { return GetParam() == Place::OtherHost || GetParam() == Place::GroupOfOtherHost; }

  /// Each in a group of its own: one that ends must not end the calls to others.
  static std::string group_of(const std::string& name) {
    switch (GetParam()) {
      case Place::Main: return "main";
      case Place::Group: return name;
      case Place::OtherHost: return "far";
      case Place::GroupOfOtherHost: return "far/" + name;
    }
    return "";
  }
  void load(const std::string& component, const std::string& name, const std::string& parameters = "") {
    system().load_in(group_of(name), component, name, parameters);
  }
  /// Of a group of this host.
  pid_t process_of(const std::string& name) { return system().group(group_of(name)).process(); }
  /// Those of all providers.
  std::vector<pid_t> processes() {
    if (GetParam() == Place::OtherHost) return {other->process()};
    std::vector<pid_t> all;
    if (GetParam() == Place::Group) {
      for (const std::string name : {"quiet", "ringer", "answerer", "sink"}) all.push_back(process_of(name));
    } else {
      for (const pid_t one : SupervisedHost::children_of(other->process())) {
        if (content_of("/proc/" + std::to_string(one) + "/cmdline").find("--endpoint") != std::string::npos)
          all.push_back(one);
      }
    }
    EXPECT_EQ(all.size(), 4U);
    return all;
  }
  static void send_all(const std::vector<pid_t>& all, int signal) {
    for (const pid_t one : all) {
      if (one > 0) ::kill(one, signal);  // 0: this test's own
    }
  }

  /// Returns when they stand: the signal alone leaves them some time.
  void stop_all(const std::vector<pid_t>& all) {
    send_all(all, SIGSTOP);
    const auto stands = [](pid_t process) {
      std::error_code gone;
      for (const auto& thread :
           std::filesystem::directory_iterator("/proc/" + std::to_string(process) + "/task", gone)) {
        if (content_of(thread.path() / "status").find("State:\tT") == std::string::npos) return false;
      }
      return true;
    };
    const auto end = Steady::now() + std::chrono::seconds(10);
    for (const pid_t one : all) {
      while (!stands(one)) ASSERT_LT(Steady::now(), end);
    }
  }

  unsigned begin(const std::string& call, const std::string& parameters = "") {
    system().set("caller",
                 "call=" + call + " go=" + std::to_string(++go) + (parameters.empty() ? "" : " " + parameters));
    return go;
  }
  Outcome outcome_of(unsigned number) {
    const auto report = system().wait_for(outcomes, [&](const SeenSample& one) { return one.number() == number; });
    return static_cast<Outcome>(static_cast<int>(report.value()));
  }
  /// Has put one value, which is there, and waits for the next.
  void wait_for_update() {
    system().state("quiet", "active");
    system().eventually("put", [&] { return system().port("caller.samples").messages() == 1; });
    ASSERT_EQ(outcome_of(begin("latest")), Outcome::Ok);
    begin_wait("wait_update");
  }
  void ask() {
    begin_wait("query", "manner=never");
    system().eventually("asked", [&] { return system().read("answerer.open").value() == 1; });
  }
  void begin_wait(const std::string& call, const std::string& parameters = "") {
    waits[begin(call, parameters)] = call;
  }
  /// The same calls from the threads of other components, each named after its call.
  void load_threads() {
    for (const std::string call : {"wait_update", "query", "event", "send_acknowledged"}) {
      system().load_in("", "thread-caller", call, "deadline_ms=100000 manner=never every=0");
      threads[call] = system().watch(call + ".outcome");
      system().wire(call + ".samples", "quiet.newest");
      system().wire(call + ".echo", "answerer.echo");
      system().wire(call + ".bell", "ringer.bell");
      system().wire(call + ".orders", "sink.orders");
    }
    system().set("event", "call=activate go=1");
    system().wait_for(threads["event"],
                      [](const auto& one) { return one.value() == static_cast<double>(Outcome::Ok); });
  }
  /// Returns once it waits.
  void begin_in_thread(const std::string& call, const std::string& parameters = "") {
    constexpr int kGo = 2;
    system().set(call, "call=" + call + " go=" + std::to_string(kGo) + " " + parameters);
    system().eventually("it has begun", [&] { return system().read(call + ".begun").value() == kGo; });
    threads_that_wait.insert(call);
  }
  /// Unless it is so late that who has stood still since then may have been given up.
  void expect_all_wait(const Moment& since) {
    constexpr std::int64_t kSoon_ns = 800'000'000;
    if (now_ns() - since.at_ns > kSoon_ns) return;
    for (const auto& one : system().take(outcomes)) ADD_FAILURE() << waits[static_cast<unsigned>(one.number())];
    for (const auto& call : threads_that_wait) EXPECT_TRUE(system().take(threads[call]).empty()) << call;
  }
  /// All that wait do so, no later than this after `since`.
  void expect_disconnected(const Moment& since, double bound_ms) {
    std::map<unsigned, Outcome> ended;
    std::map<std::string, std::vector<Outcome>> ended_in_thread;
    system().eventually("all have ended", [&] {
      for (const auto& one : system().take(outcomes))
        ended[static_cast<unsigned>(one.number())] = static_cast<Outcome>(static_cast<int>(one.value()));
      for (const auto& call : threads_that_wait) {
        for (const auto& one : system().take(threads[call]))
          ended_in_thread[call].push_back(static_cast<Outcome>(static_cast<int>(one.value())));
      }
      return ended.size() == waits.size() && ended_in_thread.size() == threads_that_wait.size();
    });
    const double took_ms = static_cast<double>(now_ns() - since.at_ns) / 1e6;
    for (const auto& [number, call] : waits) EXPECT_EQ(ended[number], Outcome::Disconnected) << call;
    for (const auto& call : threads_that_wait)
      EXPECT_EQ(ended_in_thread[call], std::vector<Outcome>{Outcome::Disconnected}) << call;
    const double within_ms = told_within(bound_ms, since);
    EXPECT_LE(took_ms, within_ms + pulse.longest_ms());
    std::cout << "told after " << took_ms << " ms (bound " << bound_ms << " ms, here " << within_ms << " ms)\n";
    waits.clear();
    threads_that_wait.clear();
  }
  void expect_latest_disconnected() {
    if (GetParam() == Place::GroupOfOtherHost) return;  // that host has started it again, and it has put anew
    EXPECT_EQ(outcome_of(begin("latest")), Outcome::Disconnected) << "and never the old value";
  }

  const TemporaryDirectory directory;
  std::unique_ptr<OtherHost> other;
  std::unique_ptr<RunningSystem> running;
  Pulse pulse;
  std::uint64_t outcomes = 0;
  unsigned go = 0;
  std::map<unsigned, std::string> waits;
  std::map<std::string, std::uint64_t> threads;  ///< watches of their outcomes, by their calls
  std::set<std::string> threads_that_wait;
};

// ---- its process is killed, or stands still -------------------------------------------------------------------

using KilledProvider = LostProvider;
using StoppedProvider = LostProvider;

TEST_P(KilledProvider, EndsEachCallThatWaitsDisconnectedInTime) {
  wait_for_update();
  ask();
  begin_wait("event");
  const auto all = processes();
  const Moment stopped;
  stop_all(all);  // or it would acknowledge
  begin_wait("send_acknowledged");
  expect_all_wait(stopped);
  const Moment since;
  send_all(all, SIGKILL);
  expect_disconnected(since, GetParam() == Place::OtherHost ? kSilent_ms : kDies_ms);
  expect_latest_disconnected();
}

TEST_P(StoppedProvider, EndsEachCallThatWaitsDisconnectedInTime) {
  wait_for_update();
  ask();
  begin_wait("event");
  const auto all = processes();
  const Moment since;
  stop_all(all);
  begin_wait("send_acknowledged");
  expect_all_wait(since);
  expect_disconnected(since, GetParam() == Place::OtherHost ? kSilent_ms : kStops_ms);
  expect_latest_disconnected();
}

TEST_P(KilledProvider, EndsEachCallOfAThreadThatWaitsDisconnectedInTimeAndOnce) {
  load_threads();
  for (const std::string call : {"wait_update", "query", "event"}) begin_in_thread(call);
  const auto all = processes();
  const Moment stopped;
  stop_all(all);  // or it would acknowledge
  begin_in_thread("send_acknowledged");
  expect_all_wait(stopped);
  const Moment since;
  send_all(all, SIGKILL);
  expect_disconnected(since, GetParam() == Place::OtherHost ? kSilent_ms : kDies_ms);
}

TEST_P(StoppedProvider, EndsEachCallOfAThreadThatWaitsDisconnectedInTimeAndOnce) {
  load_threads();
  for (const std::string call : {"wait_update", "query", "event"}) begin_in_thread(call);
  const auto all = processes();
  const Moment since;
  stop_all(all);
  begin_in_thread("send_acknowledged");
  expect_all_wait(since);
  expect_disconnected(since, GetParam() == Place::OtherHost ? kSilent_ms : kStops_ms);
}

FIONA_OVER_PLACES(KilledProvider, Place::Group, Place::OtherHost, Place::GroupOfOtherHost);
FIONA_OVER_PLACES(StoppedProvider, Place::Group, Place::OtherHost, Place::GroupOfOtherHost);

// ---- its strand hangs -----------------------------------------------------------------------------------------

class HungProvider : public LostProvider {
 protected:
  /// In `main` what still hangs at the end would be left behind on purpose.
  void TearDown() override {
    for (const std::string name : {"quiet", "answerer", "ringer", "sink"}) {
      if (GetParam() != Place::Main) break;
      system().eventually("it has come back", [&] { return system().read(name + ".queue_depth").value() == 0; });
    }
    LostProvider::TearDown();
  }
  /// As its host sees it; its group is ended for it.
  void expect_hung(const std::string& name, const Moment& since) {
    if (GetParam() == Place::GroupOfOtherHost) return;  // that host has started it again
    system().eventually("failed", [&] { return system().instance(name).mode() == "failed"; });
    if (GetParam() != Place::Group) return;
    system().eventually("its group has gone", [&] { return !system().group(name).alive(); });
    EXPECT_LE(static_cast<double>(now_ns() - since.at_ns) / 1e6, told_within(kGone_ms, since) + pulse.longest_ms());
  }
  /// All calls that wait end for it.
  void expect_all_end(const std::string& name, const std::function<void()>& begin_hang) {
    const Moment since;
    begin_hang();
    expect_all_wait(since);
    expect_disconnected(since, kSticks_ms);
    expect_hung(name, since);
  }
};
using HungReceiver = HungProvider;

TEST_P(HungProvider, EndsEachCallThatWaitsDisconnectedInTime) {
  begin_wait("wait_update");
  system().set("quiet", "hang_ms=6000");
  expect_all_end("quiet", [&] { system().state("quiet", "active"); });
  expect_latest_disconnected();
  expect_all_end("answerer", [&] { begin_wait("query", "manner=stick"); });
  begin_wait("event");
  expect_all_end("ringer", [&] { system().set("ringer", "hang_ms=6000"); });
}

TEST_P(HungProvider, EndsEachCallOfAThreadThatWaitsDisconnectedInTimeAndOnce) {
  load_threads();
  begin_in_thread("wait_update");
  system().set("quiet", "hang_ms=6000");
  expect_all_end("quiet", [&] { system().state("quiet", "active"); });
  expect_all_end("answerer", [&] { begin_in_thread("query", "manner=stick"); });
  begin_in_thread("event");
  expect_all_end("ringer", [&] { system().set("ringer", "hang_ms=6000"); });
}

/// An acknowledged send does not wait for the strand: the hull has it.
TEST_P(HungReceiver, HasWhatIsSentAcknowledgedUntilItIsLost) {
  system().set("sink", "order_ms=6000");
  const Moment since;
  ASSERT_EQ(outcome_of(begin("send")), Outcome::Ok);
  EXPECT_EQ(outcome_of(begin("send_acknowledged")), Outcome::Ok);
  expect_hung("sink", since);
  EXPECT_EQ(system().port("caller.orders").connection(), control::LOST);
  EXPECT_EQ(outcome_of(begin("send")), Outcome::Disconnected);
  EXPECT_EQ(outcome_of(begin("send_acknowledged")), Outcome::Disconnected);
}

FIONA_OVER_EVERY_PLACE(HungProvider);
FIONA_OVER_PLACES(HungReceiver, Place::Main, Place::Group, Place::OtherHost);

// ---- it is cut off --------------------------------------------------------------------------------------------

class ProviderThatIsCutOff : public LostProvider {
 protected:
  void SetUp() override {
    if (!cable.missing().empty()) GTEST_SKIP() << cable.missing();
    set_up({.listen = cable.there() + ":0", .network = cable.network()});
  }
  Cable cable;
};

TEST_P(ProviderThatIsCutOff, EndsEachCallThatWaitsDisconnectedInTime) {
  wait_for_update();
  ask();
  begin_wait("event");
  const Moment since;
  cable.pull();
  begin_wait("send_acknowledged");
  expect_all_wait(since);
  expect_disconnected(since, kSilent_ms);
  expect_latest_disconnected();
}

FIONA_OVER_PLACES(ProviderThatIsCutOff, Place::OtherHost, Place::GroupOfOtherHost);

}  // namespace
}  // namespace fiona::conformance
