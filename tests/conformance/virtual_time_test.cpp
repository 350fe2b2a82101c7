// A system on a virtual clock does the same, delivery by delivery, whatever threads and processes it runs in.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>

#include <fmt/format.h>

#include <fstream>
#include <random>
#include <sstream>
#include <tuple>

#include "fiona/error.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;

constexpr int kMinglers = 8;

/// In which group the n-th instance lives.
using Placement = std::function<std::string(int)>;

std::string in_main(int) { return "main"; }
std::string in_three(int n) {
  return std::vector<std::string>{"main", "red", "blue"}.at(static_cast<std::size_t>(n % 3));
}
std::string one_far(int n) { return n == 5 ? "red" : "main"; }
std::string in_two_groups(int n) { return n < 4 ? "red" : "blue"; }

/// Every required port of every instance goes to a provider drawn at random, now and then to one in two.
void wire_at_random(RunningSystem& system, unsigned seed) {
  std::mt19937 random(seed);
  const std::vector<std::pair<std::string, std::string>> ports{
      {"each_in", "newest"}, {"newest_in", "newest"}, {"waited_in", "newest"},
      {"last_in", "last"},   {"leased_in", "leased"}, {"timed_in", "timed"},
      {"bell_in", "bell"},   {"echo_in", "echo"},     {"orders_in", "orders"}};
  for (int n = 0; n < kMinglers; ++n) {
    for (const auto& [client, provider] : ports) {
      const auto other = (static_cast<unsigned>(n) + 1 + random() % (kMinglers - 1)) % kMinglers;
      const bool push = client != "bell_in" && client != "echo_in" && client != "orders_in";
      const std::uint32_t every = push && random() % 4 == 0 ? 2 : 1;
      system.wire("m" + std::to_string(n) + "." + client, "m" + std::to_string(other) + "." + provider, every);
    }
  }
}

std::string text_of_file(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

std::size_t lines_of(const std::string& text) {
  return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
}

/// Values of a port, of a port now and then, and of a probe of the hull.
void watch_some(RunningSystem& system) {
  control::Watch now_and_then;
  now_and_then.set_min_period_ms(7);
  system.watch("m5.newest");
  system.watch("m1.last", now_and_then);
  system.watch("m4.newest.rate", now_and_then);
}

void expect_to_pass(RunningSystem& system, std::chrono::milliseconds time) {
  const auto reply = system.let_pass(time);
  EXPECT_TRUE(reply.has_met()) << reply.ShortDebugString();
}
void live(RunningSystem& system) { expect_to_pass(system, 300ms); }
void live_watched(RunningSystem& system) {
  watch_some(system);
  live(system);
}
/// Time stands while it is changed.
void live_changed(RunningSystem& system) {
  std::mt19937 random(7);
  for (int round = 0; round < 8; ++round) {
    expect_to_pass(system, 30ms);
    for (int i = 0; i < 4; ++i) {
      const unsigned client = random() % kMinglers, provider = (client + 1 + random() % (kMinglers - 1)) % kMinglers;
      const bool push = random() % 2 == 0;
      system.wire(fmt::format("m{}.{}", client, push ? "each_in" : "echo_in"),
                  fmt::format("m{}.{}", provider, push ? "newest" : "echo"));
    }
    const std::string other = fmt::format("m{}", random() % kMinglers);
    system.state(other, "neutral");
    expect_to_pass(system, 5ms);
    system.state(other, "active");
  }
  expect_to_pass(system, 1ms);
}

/// The delivery log of a random system that has lived so.
std::string deliveries(unsigned seed, std::size_t threads, const Placement& place,
                       const std::function<void(RunningSystem&)>& lives = live) {
  const TemporaryDirectory directory;
  const auto file = directory.path / "deliveries";
  {
    RunningSystem system(threads, 30s);
    system.set("host", "clock=virtual deliveries=" + file.string());
    for (int n = 0; n < kMinglers; ++n) {
      system.load_in(place(n), "mingler", "m" + std::to_string(n),
                     "seed=" + std::to_string(seed * 100 + static_cast<unsigned>(n)));
    }
    wire_at_random(system, seed);
    lives(system);
  }
  return text_of_file(file);
}

/// The first line in which two logs differ, for a failure that can be read.
std::string first_difference(const std::string& a, const std::string& b) {
  std::istringstream left(a), right(b);
  std::string x, y;
  for (int line = 1;; ++line) {
    const bool more_x = static_cast<bool>(std::getline(left, x));
    const bool more_y = static_cast<bool>(std::getline(right, y));
    if (!more_x && !more_y) return "";
    if (!more_x) x.clear();
    if (!more_y) y.clear();
    if (x != y) return "line " + std::to_string(line) + ":\n  " + x + "\n  " + y;
  }
}

TEST(VirtualTimeProcess, TheDeliveryLogIsTheSameWithOneTwoAndEightThreads) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    const std::string expected = deliveries(seed, 1, in_main);
    ASSERT_GT(lines_of(expected), 1000U);
    for (const std::size_t threads : {1U, 2U, 8U, 2U, 8U}) {
      EXPECT_EQ(first_difference(expected, deliveries(seed, threads, in_main)), "")
          << threads << " threads, seed " << seed;
    }
  }
}

TEST(VirtualTimeGroups, TheDeliveryLogIsTheSameInOneProcessAndInGroups) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    const std::string expected = deliveries(seed, 2, in_main);
    ASSERT_GT(lines_of(expected), 1000U);
    for (const auto& place : {Placement(one_far), Placement(in_two_groups), Placement(in_three)}) {
      for (const std::size_t threads : {1U, 2U, 8U}) {
        EXPECT_EQ(first_difference(expected, deliveries(seed, threads, place)), "")
            << threads << " threads, seed " << seed << ", m5 in " << place(5);
      }
    }
  }
}

TEST(VirtualTimeProcess, TheDeliveryLogOfASystemThatIsChangedIsTheSameWithOneAndEightThreads) {
  const std::string expected = deliveries(1, 1, in_main, live_changed);
  ASSERT_GT(lines_of(expected), 1000U);
  for (const std::size_t threads : {1U, 8U, 8U}) {
    EXPECT_EQ(first_difference(expected, deliveries(1, threads, in_main, live_changed)), "") << threads;
  }
}

TEST(VirtualTimeGroups, TheDeliveryLogOfASystemThatIsChangedIsTheSameEverywhere) {
  const std::string expected = deliveries(2, 2, in_main, live_changed);
  for (const auto& place : {Placement(one_far), Placement(in_two_groups), Placement(in_three)}) {
    EXPECT_EQ(first_difference(expected, deliveries(2, 8, place, live_changed)), "") << place(5);
  }
}

/// Four consumers of different appetite, one of which hears every third sample, and who waits for them.
std::string paced_deliveries(std::size_t threads, const Placement& place) {
  const TemporaryDirectory directory;
  const auto file = directory.path / "deliveries";
  {
    RunningSystem system(threads, 30s);
    system.set("host", "clock=virtual deliveries=" + file.string());
    system.load_in(place(0), "pourer", "pourer", "count=60 payload=300000 deadline_ms=40");
    for (int n = 1; n <= 4; ++n) {
      const std::string name = "s" + std::to_string(n);
      system.load_in(place(n), "sipper", name, "sip_ms=" + std::to_string(n));
      system.wire(name + ".samples", "pourer.samples", n == 3 ? 3 : 1);
      system.wire(name + ".never", "pourer.never");
    }
    const auto reply = system.let_pass(300ms);
    EXPECT_TRUE(reply.has_met()) << reply.ShortDebugString();
    EXPECT_EQ(system.port("s4.samples").messages(), 60U);
    EXPECT_EQ(system.port("s4.samples").dropped(), 0U);
  }
  return text_of_file(file);
}

TEST(VirtualTimeGroups, WaitingForRoomIsInTheDeliveryLogAndTheSameEverywhere) {
  const std::string expected = paced_deliveries(1, in_main);
  EXPECT_THAT(expected, HasSubstr("asks_room"));
  for (const auto& place : {Placement(in_main), Placement(in_two_groups), Placement(in_three)}) {
    EXPECT_EQ(first_difference(expected, paced_deliveries(8, place)), "");
  }
}

TEST(VirtualTimeGroups, WatchingLeavesTheDeliveryLogAsItIs) {
  const std::string expected = deliveries(5, 2, in_three);
  ASSERT_GT(lines_of(expected), 1000U);
  EXPECT_EQ(first_difference(expected, deliveries(5, 2, in_three, live_watched)), "");
  EXPECT_EQ(first_difference(expected, deliveries(5, 2, in_main, live_watched)), "");
}

TEST(VirtualTimeGroups, TheDeliveryLogIsSortedByTimeWireAndNumber) {
  std::istringstream log(deliveries(4, 8, in_three));
  std::tuple<double, std::string, std::uint64_t> before{-1, "", 0};
  std::size_t lines = 0;
  std::string what;
  for (auto next = before; log >> std::get<0>(next) >> std::get<1>(next) >> std::get<2>(next) >> what; before = next) {
    ASSERT_LT(before, next) << "line " << lines;
    ++lines;
  }
  EXPECT_TRUE(log.eof());
  EXPECT_GT(lines, 1000U);
}

// ---- waiting for a group --------------------------------------------------------------------------------------

/// Waits until the source's sample has this number; returns how long that took on the system's clock.
double expected_after_ms(RunningSystem& running, const std::string& port, std::uint64_t number) {
  host::System& system = running.system();
  control::Expect expect;
  expect.mutable_port()->set_instance(port.substr(0, port.find('.')));
  expect.mutable_port()->set_port(port.substr(port.find('.') + 1));
  expect.set_field("number");
  expect.set_comparison(control::GREATER_OR_EQUAL);
  expect.mutable_value()->set_integer(static_cast<std::int64_t>(number));
  system.settle();
  const auto tap = system.new_tap();
  control::Watch watch;
  *watch.mutable_port() = expect.port();
  auto answer = std::make_shared<LaterAnswer>();
  system.waits().expect(
      1, 1, expect, tap, [&] { system.tap(tap, watch); },
      [answer](control::Reply reply) {
        answer->reply = std::move(reply);
        answer->ended = true;
      });
  running.eventually("the sample", [&] { return answer->ended.load(); });
  system.untap(tap);
  EXPECT_TRUE(answer->reply.has_met()) << answer->reply.ShortDebugString();
  return answer->reply.met().after_ms();
}

TEST(VirtualTimeGroups, AnExpectationThatAGroupMeetsEndsAtTheInstantOfTheValue) {
  RunningSystem running(2, 30s);
  running.set("host", "clock=virtual");
  running.load_in("far", "source", "source", "period_ms=5");
  EXPECT_EQ(expected_after_ms(running, "source.newest", 7), 30);
  EXPECT_EQ(to_milliseconds(running.system().clock().now()), 30);
  EXPECT_EQ(expected_after_ms(running, "source.newest", 11), 20) << "time has stood in between";
}

TEST(VirtualTimeGroups, WhatIsLoadedLaterBeginsAtTheSystemsTime) {
  RunningSystem running(2, 30s);
  running.set("host", "clock=virtual");
  running.let_pass(1000ms);
  running.load_in("far", "source", "source", "period_ms=5");
  EXPECT_EQ(expected_after_ms(running, "source.newest", 3), 10);
  EXPECT_EQ(to_milliseconds(running.system().clock().now()), 1010);
}

TEST(VirtualTimeGroups, AChangeOfModeThatNamesNoTimeIsWithdrawnAfterTenSeconds) {
  for (const std::string group : {"", "far"}) {
    RunningSystem running(2, 30s);
    running.set("host", "clock=virtual");
    running.load_in(group, "mover", "mover", "work_ms=60000");
    running.load_in(group, "source", "source", "neutral");
    running.wire("mover.orders", "source.newest");
    expect_to_pass(running, 100ms);                            // its task waits for an order
    const auto change = running.begin_state("mover", "park");  // for whose end time goes on
    running.eventually("the answer", [&] { return change->ended.load(); });
    EXPECT_NEAR(to_milliseconds(running.system().clock().now()), 10'100, 100);
    EXPECT_EQ(change->reply.failure().what(),
              "'mover' did not change its mode to park in time: blocked by task 'steer'");
    EXPECT_EQ(running.instance("mover").mode(), "drive");
    EXPECT_FALSE(running.instance("mover").has_pending());
  }
}

TEST(VirtualTimeProcess, AModeWithAFreeRunningTaskIsRefusedAndTheOthersAreNot) {
  RunningSystem running(2, 30s);
  running.set("host", "clock=virtual");
  try {
    running.load_in("", "toiler", "toiler");
    FAIL() << "it was loaded";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "'toiler' cannot go to toil on a virtual clock");
    EXPECT_EQ(error.text().found, "that task runs in a thread of its own, for which virtual time cannot wait");
  }
  running.load_in("", "toiler", "toiler", "neutral");
  EXPECT_EQ(running.instance("toiler").mode(), "neutral");
}

// ---- time that cannot go on -----------------------------------------------------------------------------------

void expect_a_named_standstill(const std::string& group, const std::string& named) {
  RunningSystem running(2, 300ms);
  running.set("host", "clock=virtual");
  running.load_in(group, "hog", "hog", "from_ms=10 for_ms=3000");
  auto reply = running.let_pass(100ms);
  // On a machine that is itself busy, time may stand for so long before the handler begins.
  for (int tries = 0; tries < 50 && reply.has_failure() && reply.failure().found() != named; ++tries) {
    reply = running.let_pass(100ms);
  }
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().code(), static_cast<std::uint32_t>(ErrorCode::Unreachable));
  EXPECT_EQ(reply.failure().what(), "virtual time has stood at 0.010 s for 0.3 s");
  EXPECT_EQ(reply.failure().found(), named);
  for (int tries = 0; tries < 50 && !reply.has_met(); ++tries) reply = running.let_pass(100ms);
  EXPECT_TRUE(reply.has_met()) << "goes on once the handler has ended";
}

TEST(VirtualTimeProcess, AHandlerThatDoesNotEndIsNamedToWhoeverWaits) { expect_a_named_standstill("", "'hog' runs"); }

TEST(VirtualTimeGroups, AHandlerOfAGroupThatDoesNotEndIsNamedToWhoeverWaits) {
  expect_a_named_standstill("far", "'hog' in group 'far' runs");
}

TEST(VirtualTimeGroups, AGroupThatIsStoppedIsNamedAsSilent) {
  RunningSystem running(2, 300ms);
  running.set("host", "clock=virtual");
  running.load_in("far", "source", "source", "period_ms=5");
  running.system().settle();
  const auto far = running.system().child_groups().at(0)->process();
  ::kill(far, SIGSTOP);
  // Its threads stop one after the other: until the last has, time may still go on.
  running.eventually("the group's stop", [far] {
    siginfo_t info{};
    return ::waitid(P_PID, static_cast<id_t>(far), &info, WSTOPPED | WNOHANG | WNOWAIT) == 0 && info.si_pid == far;
  });
  const auto reply = running.let_pass(100ms);
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().found(), "group 'far' is silent");
  ::kill(far, SIGCONT);
}

/// Each puts what it hears, and hears what the other puts: no time passes.
TEST(VirtualTimeProcess, HandlersThatPutToEachOtherWithoutEndAreToldToWhoeverWaits) {
  RunningSystem running(2, 300ms);
  running.set("host", "clock=virtual");
  for (const std::string name : {"one", "other"}) running.load_in("", "turner", name);
  running.wire("one.in", "other.out");
  running.wire("other.in", "one.out");
  const std::string named = "handlers that do not put to each other without end in one instant";
  auto reply = running.let_pass(100ms);
  // On a machine that is itself busy, one handler may take so long.
  for (int tries = 0; tries < 50 && reply.has_failure() && reply.failure().expected() != named; ++tries) {
    reply = running.let_pass(100ms);
  }
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().code(), static_cast<std::uint32_t>(ErrorCode::Unreachable));
  EXPECT_EQ(reply.failure().expected(), named);
  running.unwire("one.in");
  for (int tries = 0; tries < 50 && !reply.has_met(); ++tries) reply = running.let_pass(100ms);
  EXPECT_TRUE(reply.has_met()) << "goes on once they do not";
}

TEST(VirtualTimeGroups, AGroupThatDiesDoesNotStopTime) {
  RunningSystem running(2, 30s);
  running.set("host", "clock=virtual");
  running.load_in("far", "hog", "hog", "from_ms=10 die=true");
  running.load_in("far", "sink", "sink");
  running.load_in("near", "source", "source", "period_ms=5");
  running.wire("sink.each", "source.newest");
  const auto reply = running.let_pass(200ms);
  EXPECT_TRUE(reply.has_met()) << reply.ShortDebugString();
  EXPECT_EQ(running.instance("hog").mode(), "failed");
  EXPECT_THAT(running.instance("hog").reason(), HasSubstr("group 'far' exited with code 3"));
  EXPECT_EQ(running.port("source.newest").messages(), 41U) << "one at 0 and each 5 ms: its group has lost no time";
}

// ---- the host's parameter -------------------------------------------------------------------------------------

TEST(DeliveryLog, NeedsAVirtualClock) {
  RunningSystem running(2, 30s);
  try {
    running.set("host", "deliveries=anywhere");
    FAIL() << "recorded on the system clock";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "deliveries are recorded on a virtual clock");
    EXPECT_EQ(error.text().next, "set host clock=virtual deliveries=FILE");
  }
}

TEST(DeliveryLog, ThatCannotBeWrittenLeavesTheClockAsItIs) {
  RunningSystem running(2, 30s);
  try {
    running.set("host", "clock=virtual deliveries=/proc/no-such-folder/log");
    FAIL() << "opened";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "the delivery log cannot be written");
    EXPECT_EQ(error.text().found, "No such file or directory");
  }
  EXPECT_EQ(running.system().snapshot().clock(), "system");
}

TEST(DeliveryLog, OfAnotherStartBeginsAnewInTheSameFile) {
  const TemporaryDirectory directory;
  const auto file = directory.path / "deliveries";
  RunningSystem running(2, 30s);
  running.set("host", "clock=virtual deliveries=" + file.string());
  const auto recorded = [&](const std::string& start) {
    running.set("host", "start=" + start);
    running.load_in("", "source", "source", "period_ms=1");
    running.load_in("", "sink", "sink");
    running.wire("sink.each", "source.newest");
    EXPECT_TRUE(running.let_pass(10ms).has_met());
    running.unload("source");
    running.unload("sink");
    std::ifstream lines(file);
    return std::string{std::istreambuf_iterator<char>(lines), {}};
  };
  const std::string first = recorded("2024-05-31T09:30:00Z");
  const std::string second = recorded("2024-05-31T09:40:00Z");
  EXPECT_THAT(first, testing::StartsWith("1717147800."));
  EXPECT_THAT(second, testing::StartsWith("1717148400."));
  EXPECT_EQ(first.size(), second.size());
}

TEST(DeliveryLog, OnAFullDeviceEndsTheWaitWithTheReason) {
  RunningSystem running(2, 30s);
  running.set("host", "clock=virtual deliveries=/dev/full");
  running.load_in("", "source", "source", "period_ms=1");
  running.load_in("", "sink", "sink");
  running.wire("sink.each", "source.newest");
  const auto reply = running.let_pass(1'000'000ms);
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().what(), "the delivery log cannot be written");
  EXPECT_EQ(reply.failure().found(), "No space left on device");
}

}  // namespace
}  // namespace fiona::conformance
