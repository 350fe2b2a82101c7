// Probes and those who watch them (docs/patterns.md, Monitoring), in the host's process and in a group.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <csignal>
#include <future>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "fiona/error.hpp"
#include "fiona/hull_probes.hpp"
#include "samples.hpp"
#include "served_host.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

control::Watch when(control::Comparison comparison, double value, const std::string& field = "") {
  control::Watch watch;
  auto& condition = *watch.mutable_condition();
  condition.set_field(field);
  condition.mutable_compared()->set_comparison(comparison);
  condition.mutable_compared()->mutable_value()->set_number(value);
  return watch;
}
control::Watch when_is(const std::string& word) {
  control::Watch watch = when(control::EQUAL, 0);
  watch.mutable_condition()->mutable_compared()->mutable_value()->set_text(word);
  return watch;
}
control::Watch when_older_than(double age_ms) {
  control::Watch watch;
  watch.mutable_condition()->set_older_than_ms(age_ms);
  return watch;
}
control::Watch when_it_changes() {
  control::Watch watch;
  watch.mutable_condition()->set_changes(true);
  return watch;
}

class Monitoring : public testing::TestWithParam<Transport> {
 protected:
  void SetUp() override { system.load_client("gauge", "gauge", "level=1"); }

  void level(double value) { system.set("gauge", "level=" + std::to_string(value)); }
  SeenSample next(std::uint64_t watch) {
    return system.wait_for(watch, [](const auto&) { return true; });
  }
  Error refusal(const std::function<void()>& request) {
    try {
      request();
    } catch (const Error& error) {
      return error;
    }
    return Error(ErrorCode::Failed, "it was taken");
  }

  RunningSystem system{GetParam()};
};

TEST_P(Monitoring, ProbesOfAComponentAreListedWithTypeUnitAndDoc) {
  const auto probes = system.instance("gauge").probes();
  std::vector<std::string> listed;
  for (const auto& one : probes) listed.push_back(one.name() + " " + one.type() + " " + one.unit());
  EXPECT_THAT(listed, testing::ElementsAre("level double m", "count int64 ", "open bool ", "word string ",
                                           "report fiona.test.Sample ", "silent double s"));
  EXPECT_EQ(probes[0].doc(), "how high it stands");
  EXPECT_EQ(probes[0].value(), "1");
  EXPECT_EQ(probes[2].value(), "true");
}

TEST_P(Monitoring, ProbeIsReadOnceAlsoWhenNobodyWatches) {
  level(2.5);
  EXPECT_EQ(system.read("gauge.level").value(), 2.5);
  EXPECT_EQ(system.read("gauge.level").unit, "m");
  EXPECT_EQ(system.read("gauge.report").value(), 2.5);
}

TEST_P(Monitoring, LongTextIsListedUpToWhereACharacterOfItEnds) {
  const auto letters = [](int count) {
    std::string text;
    for (int i = 0; i < count; ++i) text += "ü";
    return text;
  };
  system.set("gauge", "word=a" + letters(100));
  system.eventually("its first 200 bytes hold half a letter",
                    [&] { return system.instance("gauge").probes(3).value() == "a" + letters(99) + "…"; });
  EXPECT_EQ(system.read("gauge.word").payload(), "a" + letters(100));
}

TEST_P(Monitoring, ProbeThatWasNeverSetHasNoValue) {
  EXPECT_FALSE(system.read("gauge.silent").has_value);
  EXPECT_EQ(system.instance("gauge").probes(5).age_ms(), -1);
}

TEST_P(Monitoring, HullProbesNeedNoCooperation) {
  system.load_provider("source", "source", "period_ms=2");
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("a rate", [&] { return system.read("sink.each.rate").value() > 0; });
  for (const HullProbe& one : hull_probes()) {
    const std::string of = one.of == HullProbe::Of::Port ? "each." : one.of == HullProbe::Of::Task ? "poller." : "";
    const auto value = system.read("sink." + of + std::string(one.name));
    const bool of_alternatives = one.name == "serving" || one.name == "flaps";
    EXPECT_EQ(value.has_value, !of_alternatives) << one.name;
    EXPECT_EQ(value.unit, one.unit) << one.name;
  }
  EXPECT_EQ(system.read("sink.mode").payload(), "active");
  EXPECT_GT(system.read("sink.poller.runs").value(), 0);
  EXPECT_LT(system.read("sink.each.age").value(), 10'000);
}

TEST_P(Monitoring, HullProbesAreTheCountersThatShowPrints) {
  const auto is = [&](const std::string& probe, double shown) { return system.read(probe).value() == shown; };
  const auto counts = [&](const std::string& probe, std::uint64_t shown) {
    return is(probe, static_cast<double>(shown));
  };
  system.load_provider("source", "source", "period_ms=20 payload=1000000");
  system.load_client("sink", "sink", "work_ms=200");
  for (const std::string port : {"each", "newest"}) system.wire("sink." + port, "source.newest");
  system.eventually("more come than are handled", [&] {
    const auto newest = system.port("sink.newest");
    return system.port("sink.each").dropped() > 0 && newest.superseded() > 0 && newest.messages() > 0;
  });
  system.set("source", "period_ms=2 payload=0 value=2e9");
  system.eventually("they break a rule", [&] { return system.port("source.newest").refused() > 0; });
  system.state("sink", "neutral");
  system.set("source", "value=0");
  system.eventually("more find it not active than were dropped",
                    [&] { return system.port("sink.each").not_active() > system.port("sink.each").dropped(); });
  system.state("source", "neutral");
  for (const std::string name : {"sink.each", "sink.newest", "source.newest"}) {
    system.eventually(name + " is read as it is shown", [&] {
      const auto shown = system.port(name);
      const double age_ms = system.read(name + ".age").value();
      return counts(name + ".superseded", shown.superseded()) && counts(name + ".dropped", shown.dropped()) &&
             counts(name + ".refused", shown.refused()) && counts(name + ".not_active", shown.not_active()) &&
             age_ms >= shown.age_ms() && age_ms <= system.port(name).age_ms();
    });
  }
  EXPECT_GT(system.instance("sink").tasks(0).overruns(), 0U);
  system.eventually("sink is read as it is shown", [&] {
    const auto shown = system.instance("sink");
    return counts("sink.poller.runs", shown.tasks(0).runs()) &&
           counts("sink.poller.overruns", shown.tasks(0).overruns()) && is("sink.handler_time", shown.handler_ms()) &&
           is("sink.cpu_time", shown.cpu_ms()) && counts("sink.queue_depth", shown.queue_depth()) &&
           system.read("sink.mode").payload() == shown.mode();
  });
}

TEST_P(Monitoring, PushModeGivesTheValueOfNowAndThenEach) {
  const auto watch = system.watch("gauge.level");
  EXPECT_EQ(next(watch).value(), 1);
  level(2);
  level(2);
  level(3);
  EXPECT_EQ(next(watch).value(), 2);
  EXPECT_EQ(next(watch).value(), 2);
  EXPECT_EQ(next(watch).value(), 3);
}

TEST_P(Monitoring, PrescalePassesEachNthValue) {
  control::Watch each_third;
  each_third.set_prescale(3);
  const auto watch = system.watch("gauge.level", each_third);
  for (int i = 2; i <= 7; ++i) level(i);
  EXPECT_EQ(next(watch).value(), 1);
  EXPECT_EQ(next(watch).value(), 4);
  EXPECT_EQ(next(watch).value(), 7);
}

TEST_P(Monitoring, MinimumPeriodSkipsCountedAndKeepsTheNewest) {
  control::Watch slowly;
  slowly.set_min_period_ms(100);
  const auto watch = system.watch("gauge.count", slowly);
  system.set("gauge", "burst=1000 go=1");
  const auto last = system.wait_for(watch, [](const auto& one) { return one.value() == 1000; });
  EXPECT_EQ(last.counted + last.skipped, 1000U);
  EXPECT_LT(last.counted, 100U);
}

TEST_P(Monitoring, AboveTellsWhenItBecomesTrueAndAgainAfterItWasFalse) {
  const auto watch = system.watch("gauge.level", when(control::GREATER, 3));
  for (const double value : {2.0, 3.0, 3.5, 4.0, 2.0, 2.5, 5.0, 6.0}) level(value);
  EXPECT_EQ(next(watch).value(), 3.5);
  EXPECT_EQ(next(watch).value(), 5);
  level(1);
  level(7);
  EXPECT_EQ(next(watch).value(), 7);
}

TEST_P(Monitoring, BelowTellsWhenItBecomesTrueAndAgainAfterItWasFalse) {
  const auto watch = system.watch("gauge.level", when(control::LESS, 0));
  for (const double value : {-1.0, -2.0, 0.0, -3.0}) level(value);
  EXPECT_EQ(next(watch).value(), -1);
  EXPECT_EQ(next(watch).value(), -3);
}

TEST_P(Monitoring, IsTellsWhenTheValueIsThatNumberAndNeitherAboveNorBelow) {
  const auto watch = system.watch("gauge.level", when(control::EQUAL, 3));
  for (const double value : {2.0, 4.0, 3.0, 3.5, 2.5, 3.0, 4.0}) level(value);
  EXPECT_EQ(next(watch).value(), 3);
  EXPECT_EQ(next(watch).value(), 3);
  level(2);
  EXPECT_EQ(next(system.watch("gauge.level")).value(), 2);
  EXPECT_TRUE(system.take(watch).empty());
}

TEST_P(Monitoring, IsTellsWhenTheValueIsThatTextAndNeitherOneBeforeNorBehindIt) {
  const auto watch = system.watch("gauge.word", when_is("x"));
  for (const std::string word : {"w", "y", "x", "xx", "w", "x", "y"}) system.set("gauge", "word=" + word);
  EXPECT_EQ(next(watch).payload(), "x");
  EXPECT_EQ(next(watch).payload(), "x");
  EXPECT_EQ(next(system.watch("gauge.word")).payload(), "y");
  EXPECT_TRUE(system.take(watch).empty());
}

TEST_P(Monitoring, IsTellsWhenTheValueIsThatEnumeratorAndNoOther) {
  system.load_client("clerk", "clerk");
  const auto walks = system.watch("clerk.pace", when_is("WALK")), runs = system.watch("clerk.pace", when_is("RUN"));
  for (const std::string pace : {"RUN", "WALK", "RUN"}) system.set("clerk", "pace=" + pace);
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(next(walks).payload(), "WALK");
    EXPECT_EQ(next(runs).payload(), "RUN");
  }
  EXPECT_EQ(next(system.watch("clerk.pace")).payload(), "RUN");
  EXPECT_TRUE(system.take(walks).empty());
  EXPECT_TRUE(system.take(runs).empty());
}

TEST_P(Monitoring, ConditionThatHoldsAlreadyTellsAtOnce) {
  level(9);
  EXPECT_EQ(next(system.watch("gauge.level", when(control::GREATER, 3))).value(), 9);
}

TEST_P(Monitoring, ConditionOfAnObjectNamesAField) {
  const auto watch = system.watch("gauge.report", when(control::GREATER, 3, "value"));
  level(2);
  level(4);
  EXPECT_EQ(next(watch).value(), 4);
}

TEST_P(Monitoring, ConditionTakesTheUnitsOfTheProbe) {
  auto above = when(control::GREATER, 300);
  above.mutable_condition()->mutable_compared()->mutable_value()->set_unit("cm");
  const auto watch = system.watch("gauge.level", above);
  level(2.9);
  level(3.1);
  EXPECT_EQ(next(watch).value(), 3.1);
}

TEST_P(Monitoring, ChangesTellsEachValueThatDiffersFromTheOneBefore) {
  const auto watch = system.watch("gauge.level", when_it_changes());
  for (const double value : {1.0, 2.0, 2.0, 2.0, 1.0}) level(value);
  EXPECT_EQ(next(watch).value(), 2);
  EXPECT_EQ(next(watch).value(), 1);
}

TEST_P(Monitoring, AgeTellsOnceWhenNothingNewHasComeForSoLong) {
  const auto watch = system.watch("gauge.level", when_older_than(20));
  EXPECT_EQ(next(watch).value(), 1);
  level(2);
  EXPECT_EQ(next(watch).value(), 2);
  EXPECT_EQ(next(system.watch("gauge.silent", when_older_than(20))).has_value, false);
}

TEST_P(Monitoring, ConditionsWorkOnPortsToo) {
  system.load_provider("source", "source", "neutral period_ms=2 count=20");
  const auto above = system.watch("source.last", when(control::GREATER, 10, "number"));
  system.state("source", "active");
  EXPECT_EQ(next(above).number(), 11U);
  const auto silent = system.watch("source.last", when_older_than(50));
  // On a busy machine one before it may have waited as long for the next.
  system.wait_for(silent, [](const auto& one) { return one.number() == 20; });
}

TEST_P(Monitoring, DetachEndsIt) {
  const auto watch = system.watch("gauge.level");
  const auto other = system.watch("gauge.level");
  next(watch);
  system.system().untap(watch);
  level(2);
  system.wait_for(other, [](const auto& one) { return one.value() == 2; });
  EXPECT_TRUE(system.take(watch).empty());
}

TEST_P(Monitoring, EachOfSeveralWatchersGetsAllAndAConditionThatDoesNotFitEndsItsOwnWatchAlone) {
  std::vector<std::uint64_t> watches;
  for (int i = 0; i < 4; ++i) watches.push_back(system.watch("gauge.count"));
  const auto fails = system.watch("gauge.report", when(control::GREATER, 3, "payload"));
  system.set("gauge", "burst=2000 go=1");
  EXPECT_EQ(system.instance("gauge").mode(), "active");
  for (const auto watch : watches) {
    const auto last = system.wait_for(watch, [](const auto& one) { return one.value() == 2000; });
    EXPECT_EQ(last.sequence, 2000U);
  }
  EXPECT_THAT(system.end_of(fails).what(), HasSubstr("'payload' does not compare with this value"));
}

/// Its strand runs nothing for it: the time that it has spent is the same to the nanosecond, however many come and go.
TEST_P(Monitoring, AttachingReadingAndDetachingGivesTheStrandNothingToDo) {
  const auto spent_ms = [&] { return system.instance("gauge").handler_ms(); };
  double before_ms = -1;
  auto changed = std::chrono::steady_clock::now();
  system.eventually("it is at rest", [&] {
    const auto now = std::chrono::steady_clock::now();
    const double now_ms = spent_ms();
    if (now_ms != std::exchange(before_ms, now_ms)) changed = now;
    // A piece of work is counted a moment after it has ended, and who is at work may get no processor for a while.
    return now - changed > std::chrono::milliseconds(500);
  });
  const std::vector<std::string> probes{"level", "count",      "open",         "word",     "report",     "silent",
                                        "mode",  "last_error", "handler_time", "cpu_time", "queue_depth"};
  control::Watch often;
  often.set_min_period_ms(1);
  std::vector<std::uint64_t> attached;
  for (std::size_t i = 0; i < 400; ++i) {
    const std::string probe = "gauge." + probes[i % probes.size()];
    attached.push_back(i % 2 == 0 ? system.watch(probe) : system.watch(probe, often));
    if (system.read(probe).has_value) next(attached.back());
    if (attached.size() < 10) continue;
    system.system().untap(attached.front());
    attached.erase(attached.begin());
  }
  for (const std::uint64_t one : attached) system.system().untap(one);
  EXPECT_EQ(spent_ms(), before_ms);
  level(2);
  system.eventually("what it does is seen there", [&] { return spent_ms() > before_ms; });
}

/// What a stream brings to a component, while consoles attach to both of its ends and detach again, and one does not
/// read.
class MonitoringOfAStream : public testing::TestWithParam<Transport> {
 protected:
  void SetUp() override {
    control::Change source = TestConsole::load_of("source", "main", "source", "period_ms=1");
    source.mutable_load()->set_mode("neutral");
    console.change(source);
    // An answer comes behind the values that wait: no more of them than a sanitizer's copies let through in its time.
    console.load("source", host.place(), "noise",
                 FIONA_SANITIZED ? "period_ms=1 payload=20000" : "period_ms=1 payload=100000");
    console.load("listener", host.place(), "listener");
    console.change(TestConsole::wire_of("listener.samples", "source.newest"));
  }
  static std::uint64_t attach(TestConsole& by, const std::string& name) {
    auto request = by.request();
    *request.mutable_watch()->mutable_port() = port_name(name);
    by.send(request);
    return request.id();
  }
  /// Returns how many values have come of it.
  static int detach(TestConsole& by, std::uint64_t watch) {
    auto request = by.request();
    request.mutable_unwatch()->set_watch(watch);
    by.send(request);
    int values = 0;
    for (auto reply = by.receive(); reply.id() != request.id(); reply = by.receive())
      values += reply.has_sample() ? 1 : 0;
    return values;
  }
  control::PortStatus port(const std::string& name) {
    const auto wanted = port_name(name);
    const auto owner = console.instance(wanted.instance());
    for (const auto& one : owner.ports()) {
      if (one.name() == wanted.port()) return one;
    }
    throw std::runtime_error("no port " + name);
  }
  /// A probe of a whole number; -1: it has no value.
  std::int64_t number(const std::string& name) {
    auto look = console.request();
    *look.mutable_read()->mutable_probe() = port_name(name);
    const auto reply = console.ask(look);
    probe::Integer value;
    value.ParseFromString(reply.sample().object());
    return reply.sample().type().empty() ? -1 : value.value();
  }

  ServedHost host{GetParam()};
  TestConsole console{host};
};

TEST_P(MonitoringOfAStream, LosesDoublesAndReordersNothingHoweverOftenOneAttachesAndThoughOneDoesNotRead) {
  const std::vector<std::string> names{"source.newest",      "listener.samples",      "listener.samples_heard",
                                       "listener.mode",      "listener.samples.rate", "listener.queue_depth",
                                       "source.subscribers", "listener.step"};
  TestConsole deaf(host);
  for (const std::string name : {"noise.newest", "source.newest", "listener.samples", "listener.samples_heard"})
    attach(deaf, name);
  console.state("source", "active");
  TestConsole guest(host);
  int values = 0;
  for (std::size_t i = 0; i < 400; ++i) {
    const auto first = attach(guest, names[i % names.size()]);
    const auto second = attach(guest, names[(i + 3) % names.size()]);
    values += detach(guest, first) + detach(guest, second);
  }
  EXPECT_GT(values, 100);
  console.eventually("the stream has gone on", [&] { return port("source.newest").messages() > 500; });
  console.state("source", "neutral");
  const auto put = port("source.newest").messages();
  const auto heard = [&] { return number("listener.samples_heard"); };
  console.eventually("all are heard", [&] { return heard() >= static_cast<std::int64_t>(put); });
  EXPECT_EQ(heard(), static_cast<std::int64_t>(put)) << "the handler ran once for each";
  EXPECT_EQ(port("listener.samples").messages(), put);
  EXPECT_EQ(console.read("listener.disorder"), "");
  EXPECT_EQ(number("listener.step"), 1) << "from each to the next";
  EXPECT_EQ(number("listener.overlaps"), -1);
  for (const std::string end : {"source.newest", "listener.samples"}) {
    EXPECT_EQ(port(end).dropped() + port(end).superseded() + port(end).refused() + port(end).not_active(), 0U) << end;
  }
}

FIONA_OVER_EVERY_TRANSPORT(MonitoringOfAStream);

TEST_P(Monitoring, EventIsNeverDroppedSilently) {
  const auto watch = system.watch("gauge.count", when_it_changes());
  system.set("gauge", "burst=20000 go=1");
  constexpr double kBurst = 20'000;
  std::uint64_t seen = 0;
  std::uint64_t missing = 0;
  host::Gaps gaps;
  SeenSample last;
  double last_value = 1;  // the first one, from which the others differ
  system.eventually("the end of the burst", [&] {
    for (const auto& one : system.take(watch)) {
      ++seen;
      EXPECT_GT(one.counted, last.counted);
      wire::Tapped tapped;
      tapped.set_number(one.counted);
      tapped.set_skipped(one.skipped);
      const std::uint64_t before = gaps.before(tapped);
      const double value = one.counted < kBurst ? one.value() : kBurst + one.value();
      EXPECT_EQ(static_cast<double>(before), value - last_value - 1) << "what it says is missing is what has not come";
      missing += before;
      last_value = value;
      last = one;
    }
    if (last.counted == 19'999) return true;
    // What did not fit was the end of it: the next event shows the gap.
    if (system.read("gauge.count").value() == 20'000 && last.counted > 0) system.set("gauge", "burst=1 go=2");
    return last.counted > 19'999;
  });
  EXPECT_EQ(seen + missing, last.counted);
}

TEST_P(Monitoring, WorksInEveryLifeCycleState) {
  for (const std::string mode : {"neutral", "deactivated", "active"}) {
    system.state("gauge", mode);
    EXPECT_EQ(system.read("gauge.level").value(), 1) << mode;
    EXPECT_EQ(next(system.watch("gauge.level")).value(), 1) << mode;
    EXPECT_EQ(next(system.watch("gauge.mode")).payload(), mode);
  }
  const auto mode = system.watch("gauge.mode", when_it_changes());
  const auto error = system.watch("gauge.last_error", when_it_changes());
  system.set("gauge", "fail_with=worn");
  EXPECT_EQ(next(mode).payload(), "failed");
  EXPECT_EQ(next(error).payload(), "worn");
  EXPECT_EQ(system.read("gauge.level").value(), 1);
  EXPECT_EQ(next(system.watch("gauge.level")).value(), 1);
  EXPECT_EQ(next(system.watch("gauge.handler_time")).unit, "ms");
  EXPECT_EQ(next(system.watch("gauge.cpu_time")).unit, "ms");
}

TEST_P(Monitoring, HandlerThatHangsIsSeenFromOutside) {
  system.load_provider("source", "source", "period_ms=1");
  system.load_client("sink", "sink", "work_ms=300");
  const auto waiting = system.watch("sink.each.queue_depth", when(control::GREATER, 20));
  system.wire("sink.each", "source.newest");
  EXPECT_GT(next(waiting).value(), 20);
}

TEST_P(Monitoring, HullSamplesOnlyAsOftenAsItIsAsked) {
  control::Watch often;
  often.set_min_period_ms(10);
  const auto slow = system.watch("gauge.queue_depth");
  const auto fast = system.watch("gauge.queue_depth", often);
  system.wait_for(slow, [](const auto& one) { return one.counted == 10; });
  const auto fast_samples = system.take(fast);
  ASSERT_FALSE(fast_samples.empty());
  EXPECT_GT(fast_samples.back().counted, 20U);
}

TEST_P(Monitoring, WatcherIsToldThatTheInstanceWasUnloaded) {
  const auto watch = system.watch("gauge.level");
  const auto sampled = system.watch("gauge.handler_time");
  system.unload("gauge");
  EXPECT_EQ(system.end_of(watch).what(), "'gauge' was unloaded");
  EXPECT_EQ(system.end_of(sampled).what(), "'gauge' was unloaded");
}

TEST_P(Monitoring, ExpectIsMetByTheValueOfNow) {
  control::Expect request;
  request.mutable_port()->set_instance("gauge");
  request.mutable_port()->set_port("level");
  request.set_comparison(control::GREATER_OR_EQUAL);
  request.mutable_value()->set_number(1);
  request.set_within_ms(5000);
  std::promise<control::Reply> answered;
  control::Watch watch;
  *watch.mutable_port() = request.port();
  const auto tap = system.system().new_tap();
  const auto expected = system.system().expected(request);
  system.system().waits().expect(
      1, 1, expected, tap, [&] { system.system().tap(tap, watch); },
      [&](control::Reply reply) { answered.set_value(std::move(reply)); });
  auto answer = answered.get_future();
  system.eventually("met", [&] { return answer.wait_for(0s) == std::future_status::ready; });
  EXPECT_EQ(answer.get().met().seen(), "1");
}

TEST_P(Monitoring, UnknownProbeGetsTheNearest) {
  const Error error = refusal([&] { system.watch("gauge.levle"); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_EQ(error.text().what, "'gauge' has no port or probe 'levle'");
  EXPECT_EQ(error.text().near.front(), "level");
}

TEST_P(Monitoring, WhatTheHullReadsIsNeverOld) {
  const Error error = refusal([&] { system.watch("gauge.handler_time", when_older_than(20)); });
  EXPECT_EQ(error.text().what, "gauge.handler_time is never old: the hull reads it when it is asked");
}

using MonitoringOfAStart = Monitoring;

/// While its start takes long. A host that leads waits for those of others.
TEST_P(MonitoringOfAStart, WorksInInit) {
  const auto loaded = system.begin_load_client("gauge", "slow", "level=3 start_ms=3000");
  const auto level = system.watch("slow.level");
  const auto mode = system.watch("slow.mode");
  EXPECT_EQ(next(mode).payload(), "init");
  system.eventually("its start has shown it", [&] { return system.read("slow.level").value() == 3; });
  EXPECT_EQ(system.wait_for(level, [](const auto& one) { return one.has_value; }).value(), 3);
  EXPECT_EQ(next(system.watch("slow.handler_time")).unit, "ms");
  EXPECT_EQ(system.read("slow.mode").payload(), "init");
  EXPECT_FALSE(loaded->ended);
  EXPECT_EQ(next(mode).payload(), "active");
  system.eventually("it has started", [&] { return loaded->ended.load(); });
}

FIONA_OVER(MonitoringOfAStart, Transport::Process, Transport::Ipc);
FIONA_OVER_EVERY_TRANSPORT(Monitoring);

using MonitoringOfAGroup = OverTransports;

/// Whether a host that does not answer has ended, or was cut off, is known when it is there again.
TEST_P(MonitoringOfAGroup, WatcherIsToldThatTheProcessHasEnded) {
  const bool is_host = GetParam() == Transport::Tcp;
  const std::string why = is_host ? "host 'far' was started anew" : "group 'far' killed by signal 9";
  system.load_client("gauge", "gauge", "level=1");
  const auto watch = system.watch("gauge.level");
  ::kill(system.far_process(), SIGKILL);
  if (is_host) system.start_far_host_anew();
  EXPECT_THAT(system.end_of(watch).what(), HasSubstr(why));
  EXPECT_THAT([&] { system.watch("gauge.level"); },
              testing::ThrowsMessage<Error>(HasSubstr("'gauge' is lost: " + why)));
}

FIONA_OVER(MonitoringOfAGroup, Transport::Ipc, Transport::Tcp);

}  // namespace
}  // namespace fiona::conformance
