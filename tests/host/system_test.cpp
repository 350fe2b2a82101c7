// What the host says when it cannot do what is asked, how scripts wait, and what a death in a group does.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <future>
#include <optional>

#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "stopped_process.hpp"
#include "system_fixture.hpp"

namespace fiona::host {
namespace {

using conformance::RunningSystem;
using conformance::Transport;
using testing::ElementsAre;
using testing::HasSubstr;

template <class F>
std::optional<Error> error_of(F request) {
  try {
    request();
  } catch (const Error& error) {
    return error;
  }
  return std::nullopt;
}

class Wiring : public testing::Test {
 protected:
  Wiring() {
    system.load_provider("source", "source");
    system.load_client("sink", "sink");
  }
  std::optional<Error> error_of_wire(const std::string& client, const std::string& provider) {
    return error_of([&] { system.wire(client, provider); });
  }
  RunningSystem system;
};

TEST_F(Wiring, RefusalNamesBothPortsBothServicesAndWhoWouldFit) {
  const auto error = error_of_wire("sink.each", "source.timed");
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::WiringInvalid);
  EXPECT_EQ(
      error->text().what,
      "sink.each requires SampleNewest (push newest, Sample); source.timed provides SampleTimed (push timed, Sample)");
  EXPECT_EQ(error->text().next, "these provide SampleNewest: sink.latest_report, source.newest");
  EXPECT_EQ(system.port("sink.each").connection(), control::UNWIRED);
}

TEST_F(Wiring, RefusalSaysWhenNobodyWouldFit) {
  system.load_client("asker", "asker", "neutral");
  const auto error = error_of_wire("asker.echo", "source.newest");
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(
      error->text().what,
      "asker.echo requires Echo (query, Question -> Reply); source.newest provides SampleNewest (push newest, Sample)");
  EXPECT_EQ(error->text().next, "nothing here provides Echo: spots shows who could");
}

TEST_F(Wiring, UnknownClientGetsTheNearestName) {
  const auto error = error_of_wire("snk.each", "source.newest");
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::NotFound);
  EXPECT_EQ(error->text().what, "there is no instance 'snk'");
  EXPECT_THAT(error->text().near, ElementsAre("sink"));
}

TEST_F(Wiring, UnknownPortGetsTheNearestName) {
  const auto error = error_of_wire("sink.each", "source.newst");
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::NotFound);
  EXPECT_EQ(error->text().what, "'source' has no port 'newst' that provides");
  EXPECT_THAT(error->text().near, ElementsAre("newest"));
  EXPECT_EQ(error->text().next, "show source");
}

TEST_F(Wiring, PortsTheWrongWayRoundAreToldApart) {
  const auto error = error_of_wire("source.newest", "sink.each");
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::Usage);
  EXPECT_EQ(error->text().what, "source.newest provides SampleNewest");
  EXPECT_EQ(error->text().expected, "a port that requires");
}

TEST_F(Wiring, WiringTheSameTwiceSaysSoAndChangesNothing) {
  system.wire("sink.each", "source.newest");
  control::Change change;
  control::Wire& again = *change.mutable_wire();
  again.mutable_client()->set_instance("sink");
  again.mutable_client()->set_port("each");
  again.mutable_provider()->set_instance("source");
  again.mutable_provider()->set_port("newest");
  EXPECT_EQ(system.system().perform(change).note(), "wired so already");
  EXPECT_EQ(system.port("source.newest").clients_size(), 1);
}

TEST_F(Wiring, RefusedRewiringLeavesTheOldWireWorking) {
  system.wire("sink.each", "source.newest");
  ASSERT_TRUE(error_of_wire("sink.each", "source.timed").has_value());
  const auto before = system.port("sink.each").messages();
  system.eventually("goes on", [&] { return system.port("sink.each").messages() > before + 2; });
  EXPECT_EQ(system.port("sink.each").peer().port(), "newest");
}

TEST_F(Wiring, UnwiringWhatHasNoWireSaysSo) {
  const auto error = error_of([&] { system.unwire("sink.each"); });
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::NotFound);
  EXPECT_EQ(error->text().what, "sink.each has no wire");
}

TEST_F(Wiring, UnloadingAClientMentionsNobodyAndFreesItsProvider) {
  system.wire("sink.each", "source.newest");
  control::Change change;
  change.mutable_unload()->set_instance("sink");
  EXPECT_EQ(system.system().perform(change).note(), "unloaded sink");
  EXPECT_EQ(system.port("source.newest").clients_size(), 0);
}

// ---- parameters -----------------------------------------------------------------------------------------------

class Parameters : public testing::Test {
 protected:
  Parameters() { system.load_provider("source", "source", "neutral period_ms=7 count=3"); }

  static control::Argument argument(const std::string& name, double number, const std::string& unit = "") {
    control::Argument one;
    one.set_name(name);
    one.mutable_value()->set_number(number);
    one.mutable_value()->set_unit(unit);
    return one;
  }
  std::optional<Error> error_of_set(const std::vector<control::Argument>& arguments) {
    control::Change change;
    control::Set& request = *change.mutable_set();
    request.set_instance("source");
    for (const auto& one : arguments) *request.add_parameters() = one;
    return error_of([&] { system.system().perform(change); });
  }
  std::string value(const std::string& name) {
    const auto source = system.instance("source");
    for (const auto& one : source.parameters()) {
      if (one.name() == name) return one.value();
    }
    return "no such parameter";
  }
  RunningSystem system;
};

TEST_F(Parameters, ValueInAnotherUnitIsConvertedToTheFields) {
  EXPECT_FALSE(error_of_set({argument("period_ms", 0.2, "s")}).has_value());
  EXPECT_EQ(value("period_ms"), "200");
}

TEST_F(Parameters, UnitOfAnotherDimensionIsRefused) {
  const auto error = error_of_set({argument("period_ms", 3, "m")});
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::Usage);
  EXPECT_EQ(error->text().what, "parameter 'period_ms' does not take this value");
  EXPECT_EQ(error->text().expected, "a number in ms");
  EXPECT_EQ(error->text().found, "3m");
  EXPECT_EQ(value("period_ms"), "7");
}

TEST_F(Parameters, ValueOutsideItsRangeIsRefusedWithTheRule) {
  const auto error = error_of_set({argument("period_ms", 20, "s")});
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->text().what, "refused: period_ms is 20000, above 10000 ms");
  EXPECT_EQ(error->text().where, "source");
  EXPECT_EQ(error->text().next, "get source");
  EXPECT_EQ(value("period_ms"), "7");
}

TEST_F(Parameters, OneWrongValueAmongSeveralChangesNone) {
  ASSERT_TRUE(error_of_set({argument("count", 5), argument("period_ms", -1)}).has_value());
  EXPECT_EQ(value("count"), "3");
  EXPECT_EQ(value("period_ms"), "7");
}

TEST_F(Parameters, NotANumberIsRefused) {
  const auto error = error_of_set({argument("period_ms", std::numeric_limits<double>::quiet_NaN())});
  ASSERT_TRUE(error.has_value());
  EXPECT_THAT(error->text().what, HasSubstr("not a finite number"));
  EXPECT_EQ(value("period_ms"), "7");
}

TEST_F(Parameters, UnknownNameGetsTheNearest) {
  const auto error = error_of_set({argument("count", 5), argument("periodms", 3)});
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::NotFound);
  EXPECT_EQ(error->text().what, "there is no parameter 'periodms'");
  EXPECT_EQ(error->text().expected, "one of period_ms, count, payload, fail_with, vouch, value, hang_ms");
  EXPECT_THAT(error->text().near, ElementsAre("period_ms"));
  EXPECT_EQ(value("count"), "3");
}

TEST_F(Parameters, ValueOfAnotherKindIsRefused) {
  control::Argument flag;
  flag.set_name("period_ms");
  flag.mutable_value()->set_flag(true);
  const auto error = error_of_set({flag});
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->text().found, "true");
  EXPECT_EQ(value("period_ms"), "7");
}

TEST_F(Parameters, FractionForAWholeNumberIsRefused) {
  const auto error = error_of_set({argument("count", 2.5)});
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->text().expected, "a whole number from 0 to 18446744073709551615");
  EXPECT_EQ(value("count"), "3");
}

// ---- modes ----------------------------------------------------------------------------------------------------

TEST(Modes, UnknownModeIsToldWhichThereAre) {
  RunningSystem system;
  system.load_provider("source", "source");
  const auto error = error_of([&] { system.state("source", "activ"); });
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::Usage);
  EXPECT_EQ(error->text().what, "'source' cannot go from active to activ");
  EXPECT_EQ(error->text().expected, "one of active, neutral, deactivated");
  EXPECT_THAT(error->text().near, ElementsAre("active"));
}

TEST(Modes, FailedInstanceStaysFailedWithItsReason) {
  RunningSystem system;
  system.load_provider("source", "source", "period_ms=1");
  system.set("source", "fail_with=worn-out");
  system.eventually("failed", [&] { return system.instance("source").mode() == "failed"; });
  const auto error = error_of([&] { system.state("source", "active"); });
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error->text().found, "failed: worn-out");
  EXPECT_EQ(error->text().next, "unload source, then load it again");
}

// ---- clock and waits ------------------------------------------------------------------------------------------

void set_host(RunningSystem& system, const std::string& name, const std::string& text) {
  control::Change change;
  control::Set& request = *change.mutable_set();
  request.set_instance("host");
  auto& argument = *request.add_parameters();
  argument.set_name(name);
  argument.mutable_value()->set_text(text);
  system.system().perform(change);
}

class VirtualTime : public testing::Test {
 protected:
  VirtualTime() { set_host(system, "clock", "virtual"); }

  double time_ms() { return 1e3 * to_seconds(system.system().clock().now() - system.system().clock().start()); }
  Waits::Answer answer() {
    return [this](control::Reply reply) { answered.set_value(std::move(reply)); };
  }
  control::Reply wait() {
    auto future = answered.get_future();
    if (future.wait_for(std::chrono::seconds(20)) != std::future_status::ready) throw std::runtime_error("no answer");
    auto reply = future.get();
    answered = {};
    return reply;
  }
  control::Reply expect(const std::string& field, control::Comparison comparison, std::int64_t value,
                        double within_ms) {
    control::Expect request;
    request.mutable_port()->set_instance("source");
    request.mutable_port()->set_port("newest");
    request.set_field(field);
    request.set_comparison(comparison);
    request.mutable_value()->set_integer(value);
    request.set_within_ms(within_ms);
    control::Watch watch;
    *watch.mutable_port() = request.port();
    const auto tap = system.system().new_tap();
    system.system().waits().expect(
        1, 7, request, tap, [&] { system.system().tap(tap, watch); }, answer());
    auto reply = wait();
    system.system().untap(tap);
    return reply;
  }
  control::Reply wait_mode(const std::string& mode, double within_ms) {
    control::WaitMode request;
    request.set_instance("source");
    request.set_mode(mode);
    request.set_within_ms(within_ms);
    system.system().waits().wait_mode(1, 8, request, answer());
    return wait();
  }

  std::promise<control::Reply> answered;  ///< outlives the system, whose threads answer
  RunningSystem system;
};

TEST_F(VirtualTime, StandsUntilSomethingWaits) {
  system.load_provider("source", "source", "period_ms=10");
  EXPECT_EQ(time_ms(), 0);
  EXPECT_LE(system.port("source.newest").messages(), 1U);
}

TEST_F(VirtualTime, SleepEndsAtItsInstantWithAllOfIt) {
  system.load_provider("source", "source", "period_ms=10");
  control::Sleep request;
  request.set_duration_ms(1000);
  system.system().waits().sleep(1, 5, request, answer());
  const auto reply = wait();
  EXPECT_EQ(reply.id(), 5U);
  EXPECT_EQ(reply.met().after_ms(), 1000);
  EXPECT_EQ(time_ms(), 1000);
  EXPECT_EQ(system.port("source.newest").messages(), 101U) << "at 0, 10, … 1000 ms";
}

TEST_F(VirtualTime, ExpectIsMetAtTheInstantOfTheMessage) {
  system.load_provider("source", "source", "period_ms=10");
  const auto reply = expect("number", control::GREATER_OR_EQUAL, 50, 10'000);
  ASSERT_TRUE(reply.has_met()) << reply.ShortDebugString();
  EXPECT_EQ(reply.id(), 7U);
  EXPECT_EQ(reply.met().seen(), "50");
  EXPECT_EQ(time_ms(), 490);
}

TEST_F(VirtualTime, ExpectThatIsNotMetSaysWhatItSawLast) {
  system.load_provider("source", "source", "period_ms=10 count=5");
  const auto reply = expect("number", control::GREATER, 50, 300);
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().what(), "source.newest.number was not as expected within 300 ms");
  EXPECT_EQ(reply.failure().found(), "last seen: 5");
  EXPECT_EQ(reply.failure().next(), "watch source.newest");
  EXPECT_EQ(time_ms(), 300);
}

TEST_F(VirtualTime, ExpectOfAFieldThatIsNotThereFailsAtOnceWithTheNearest) {
  system.load_provider("source", "source", "period_ms=10");
  const auto reply = expect("numbre", control::EQUAL, 1, 1000);
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().code(), static_cast<std::uint32_t>(ErrorCode::NotFound));
  EXPECT_THAT(reply.failure().near(), ElementsAre("number"));
}

TEST_F(VirtualTime, WaitForAModeThatDoesNotComeEndsInTime) {
  system.load_provider("source", "source", "neutral");
  const auto reply = wait_mode("active", 250);
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().code(), static_cast<std::uint32_t>(ErrorCode::Unreachable));
  EXPECT_EQ(reply.failure().what(), "'source' did not reach mode active within 250 ms");
  EXPECT_EQ(time_ms(), 250);
}

TEST_F(VirtualTime, WaitForAModeEndsWhenTheInstanceFailsWithItsReason) {
  system.load_provider("source", "source", "period_ms=10");
  system.set("source", "fail_with=broken");
  const auto reply = wait_mode("neutral", 10'000);
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().code(), static_cast<std::uint32_t>(ErrorCode::ComponentFailed));
  EXPECT_EQ(reply.failure().found(), "broken");
  EXPECT_LE(time_ms(), 10);
}

TEST(HostClock, ChangesBeforeTheFirstLoadAndAfterTheLastUnloadOnly) {
  RunningSystem system;
  set_host(system, "clock", "virtual");
  system.load_provider("source", "source");
  const auto error = error_of([&] { set_host(system, "clock", "system"); });
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error->text().what, "1 instances live by the present clock");
  EXPECT_EQ(error->text().next, "set host clock before the first load");
  EXPECT_EQ(system.system().snapshot().clock(), "virtual");
  system.unload("source");
  set_host(system, "clock", "system");
  EXPECT_EQ(system.system().snapshot().clock(), "system");
}

TEST(HostClock, WhoWaitsForTheEndOfTheRunGoesOnWaitingWhenItChangesAndOthersAreTold) {
  const auto later = [](const std::shared_ptr<conformance::LaterAnswer>& of) {
    return [of](control::Reply reply) {
      of->reply = std::move(reply);
      of->ended = true;
    };
  };
  const auto run = std::make_shared<conformance::LaterAnswer>(), sleep = std::make_shared<conformance::LaterAnswer>();
  RunningSystem system;
  control::Sleep request;
  request.set_duration_ms(3'600'000);
  system.system().waits().run(1, 1, later(run));
  system.system().waits().sleep(2, 2, request, later(sleep));
  set_host(system, "clock", "virtual");
  ASSERT_TRUE(sleep->ended);
  EXPECT_EQ(sleep->reply.failure().what(), "the clock that was waited by has been changed");
  EXPECT_FALSE(run->ended);
  system.load_provider("source", "source", "period_ms=10");
  system.eventually("time goes on for the run", [&] { return system.port("source.newest").messages() > 10; });
  system.system().waits().end_run(3, "over");
  EXPECT_EQ(run->reply.ended().exit_code(), 3);
}

/// What a component counts from there is the same in whatever group it is.
TEST(HostClock, BeganForTheComponentsOfAGroupWhenItDidForThoseOfMain) {
  RunningSystem system;
  system.set("host", "clock=virtual start=1970-01-02T00:00:00Z");
  for (const std::string group : {"", "far"}) {
    system.load_in(group, "mingler", "in_" + group);
    EXPECT_EQ(system.instance("in_" + group).probes(0).value(), "86400");
  }
}

TEST(HostClock, UnknownParameterIsToldWhichThereAre) {
  RunningSystem system;
  const auto error = error_of([&] { set_host(system, "clock", "sundial"); });
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::Usage);
  EXPECT_THAT(error->text().expected, HasSubstr("clock=system, clock=virtual"));
}

// ---- what takes long ------------------------------------------------------------------------------------------

TEST(LongWork, AnInstanceThatEndedOnceNobodyWaitedForThatAnyMoreCanBeUnloaded) {
  RunningSystem system;
  for (const std::string name : {"sink", "source"}) system.load_in("far", name, name);
  wire::GroupRequest late;
  late.mutable_destroy()->set_instance("sink");
  system.system().child_groups().at(0)->request(late);
  system.unload("sink");
  EXPECT_EQ(system.system().snapshot().instances_size(), 1);
  system.load_in("far", "sink", "sink");
  EXPECT_EQ(system.instance("sink").mode(), "active");
}

TEST(LongWork, AWireToAGroupThatDoesNotAnswerIsOpenedOnceItDoes) {
  RunningSystem system;
  system.load_in("far", "source", "source");
  system.load_in("", "source", "other");
  system.load_in("", "sink", "sink");
  const pid_t far = system.group("far").process();
  conformance::stop_process(far);
  const auto done = system.wire_to_several("sink.each", {"source.newest", "other.newest"});
  EXPECT_THAT(done.warnings(0), HasSubstr("sink.each waits for source.newest: group 'far' does not answer"));
  ::kill(far, SIGCONT);
  system.eventually("it is opened",
                    [&] { return system.port("sink.each").providers(0).connection() == control::CONNECTED; });
}

TEST(LongWork, ATapOfWhatIsSampledKeepsToAPeriodThatLeavesTimeForOtherWork) {
  RunningSystem system;
  system.load_provider("source", "source", "period_ms=10");
  control::Watch terms;
  terms.set_min_period_ms(1e-6);
  const auto tap = system.watch("source.newest.rate", terms);
  const auto begun = std::chrono::steady_clock::now();
  system.eventually("some values",
                    [&] { return std::chrono::steady_clock::now() - begun > std::chrono::milliseconds(200); });
  system.system().untap(tap);
  const auto took_ms = (std::chrono::steady_clock::now() - begun).count() / 1'000'000;
  const auto seen = system.take(tap);
  EXPECT_GT(seen.size(), 10U);
  EXPECT_LE(seen.back().counted, static_cast<std::uint64_t>(took_ms + 1));
}

// ---- death of a group -----------------------------------------------------------------------------------------

class Death : public testing::Test {
 protected:
  void load_far(const std::string& component, const std::string& name) {
    control::Change change;
    control::Load& request = *change.mutable_load();
    request.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
    request.set_instance(name);
    request.set_group("far");
    system.system().perform(change);
  }
  /// As a crash would: no farewell, no flush.
  void kill_far() {
    const auto snapshot = system.system().snapshot();
    for (const auto& group : snapshot.groups()) {
      if (group.name() == "far") ::kill(group.process(), SIGKILL);
    }
  }
  RunningSystem system;
};

TEST_F(Death, FailsTheInstancesOfTheGroupWithTheReason) {
  load_far("source", "source");
  load_far("answerer", "answerer");
  system.load_provider("sink", "sink");
  kill_far();
  const std::string reason = "group 'far' killed by signal 9 (Killed)";
  system.eventually(reason, [&] { return system.instance("source").reason() == reason; });
  EXPECT_EQ(system.instance("source").mode(), "failed");
  EXPECT_EQ(system.instance("answerer").mode(), "failed");
  EXPECT_EQ(system.instance("sink").mode(), "active");
}

TEST_F(Death, MakesThePortsOfItsClientsLostWithTheReason) {
  load_far("source", "source");
  system.load_provider("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("connected", [&] { return system.port("sink.each").messages() > 0; });
  kill_far();
  system.eventually("lost", [&] { return system.port("sink.each").connection() == control::LOST; });
  EXPECT_EQ(system.port("sink.each").reason(), "group 'far' killed by signal 9 (Killed)");
}

TEST_F(Death, EndsPendingQueriesDisconnected) {
  load_far("answerer", "answerer");
  system.load_provider("asker", "asker", "manner=never period_ms=20");
  const auto outcome = system.watch("asker.outcome");
  system.wire("asker.echo", "answerer.echo");
  system.eventually("asked", [&] { return system.port("answerer.echo").messages() >= 1; });
  kill_far();
  system.wait_for(outcome, [](const auto& s) { return s.value() == static_cast<double>(Outcome::Disconnected); });
}

TEST_F(Death, EndsChangesOfModeThatAreUnderWay) {
  load_far("toiler", "toiler");
  system.set("toiler", "stubborn=true");
  const auto change = system.begin_state("toiler", "rest", 600'000);
  kill_far();
  system.eventually(
      "its answer", [&] { return change->ended.load(); }, std::chrono::seconds(5));
  EXPECT_EQ(change->reply.failure().what(), "'toiler' has ended: group 'far' killed by signal 9 (Killed)");
  EXPECT_EQ(change->reply.failure().next(), "show toiler");
}

TEST_F(Death, EndsCallsByHandDisconnected) {
  load_far("answerer", "answerer");
  std::atomic<bool> ended{false};
  control::Reply reply;
  control::Call request;
  request.mutable_target()->set_instance("answerer");
  request.mutable_target()->set_port("echo");
  conformance::add_arguments("manner=never", *request.mutable_arguments());
  request.set_within_ms(600'000);
  system.system().call(1, 1, request, [&](control::Reply told) {
    reply = std::move(told);
    ended = true;
  });
  kill_far();
  system.eventually(
      "its end", [&] { return ended.load(); }, std::chrono::seconds(5));
  EXPECT_EQ(reply.called().outcome(), "disconnected");
  EXPECT_EQ(reply.called().reason(), "group 'far' killed by signal 9 (Killed)");
}

TEST_F(Death, IsNoticedByARequestThatFindsIt) {
  load_far("source", "source");
  kill_far();
  const auto error = error_of([&] {
    for (int tries = 0; tries < 1000; ++tries) system.set("source", "period_ms=3");
  });
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->code(), ErrorCode::Unreachable);
  EXPECT_EQ(system.instance("source").mode(), "failed");
}

TEST_F(Death, LeavesRoomForTheGroupToBeMadeAgain) {
  load_far("source", "source");
  system.load_provider("sink", "sink");
  system.wire("sink.each", "source.newest");
  kill_far();
  system.eventually("lost", [&] { return system.port("sink.each").connection() == control::LOST; });
  system.unload("source");
  load_far("source", "source");
  system.wire("sink.each", "source.newest");
  const auto before = system.port("sink.each").messages();
  system.eventually("messages again", [&] { return system.port("sink.each").messages() > before + 2; });
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
}

}  // namespace
}  // namespace fiona::host
