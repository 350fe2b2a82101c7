// Probes and taps, without a host (docs/patterns.md, Monitoring).
#include "fiona/probe.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <thread>

#include "fiona/describe.hpp"
#include "fiona/hull_probes.hpp"
#include "fiona/pool.hpp"
#include "fiona/sdk_test/objects.fiona.hpp"
#include "fiona/testing/bench.hpp"
#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::ThrowsMessage;

class Meter final : public Component {
 public:
  using Component::Component;
  void tick() {}
  void on_number(const Number&) { depths.push_back(hull().queue_depth()); }

  std::vector<std::size_t> depths;  ///< as it was while each number was handled
  Probe<double> level{*this, "level", {.unit = "m", .doc = "how high it stands"}};
  Probe<float> ratio{*this, "ratio"};
  Probe<std::uint64_t> count{*this, "count"};
  Probe<bool> open{*this, "open"};
  Probe<std::string> word{*this, "word"};
  Probe<Colour> colour{*this, "colour"};
  Probe<Ruled> object{*this, "object"};
  Provides<Numbers> numbers{*this, "numbers"};
  Requires<Numbers> numbers_in{*this, "numbers_in", &Meter::on_number};
  Task ticker{*this, "ticker", 100ms, &Meter::tick};
};

/// Keeps what a tap says: numbers as they are, texts by their length.
class Kept final : public Watcher {
 public:
  void value(const Tapped& tapped) override {
    const std::lock_guard lock(mutex_);
    all_.push_back(tapped);
  }
  void ended(const Error& why) override {
    const std::lock_guard lock(mutex_);
    end_ = why.text().what;
  }
  std::vector<Tapped> take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(all_, {});
  }
  std::vector<double> numbers() {
    std::vector<double> numbers;
    for (const auto& one : take()) {
      const auto* number = dynamic_cast<const probe::Number*>(one.envelope.object.get());
      const auto* integer = dynamic_cast<const probe::Integer*>(one.envelope.object.get());
      numbers.push_back(number ? number->value() : integer ? static_cast<double>(integer->value()) : -1);
    }
    return numbers;
  }
  std::vector<std::string> texts() {
    std::vector<std::string> texts;
    for (const auto& one : take()) texts.push_back(dynamic_cast<const probe::Text&>(*one.envelope.object).value());
    return texts;
  }
  std::string end() {
    const std::lock_guard lock(mutex_);
    return end_;
  }

 private:
  std::mutex mutex_;
  std::vector<Tapped> all_;
  std::string end_;
};

/// Counts how often work was handed to it.
class CountingExecutor final : public Executor {
 public:
  void submit(std::shared_ptr<Runnable> runnable) override {
    ++submitted;
    inner_.submit(std::move(runnable));
  }
  void help() override { inner_.help(); }
  std::atomic<int> submitted{0};

 private:
  testing::InlineExecutor inner_;
};

class Probes : public ::testing::Test {
 protected:
  std::shared_ptr<Tap> tap(const std::string& name, TapTerms terms = {}) {
    return meter.hull.tap(name, std::move(terms), kept);
  }
  void advance(Duration duration) {
    executor.help();
    clock.stop_at(clock.now() + duration, [this] { clock.hold(); });
    clock.release();
    executor.help();
  }
  double read(const std::string& name) {
    const auto object = meter.hull.read(name).object;
    if (const auto* number = dynamic_cast<const probe::Number*>(object.get())) return number->value();
    return static_cast<double>(dynamic_cast<const probe::Integer&>(*object).value());
  }
  static TapTerms above(double limit) {
    return {
        .holds = [limit](const Object& object) { return dynamic_cast<const probe::Number&>(object).value() > limit; }};
  }

  CountingExecutor executor;
  VirtualClock clock;
  KeptEvents events;
  Made<Meter> meter{"meter", executor, clock, events};
  std::shared_ptr<Kept> kept = std::make_shared<Kept>();
};

TEST_F(Probes, InterfaceSaysNameTypeUnitAndDoc) {
  const auto interface = interface_of(meter.hull, "meter", "");
  std::vector<std::string> types;
  for (const auto& one : interface.probes()) types.push_back(one.name() + ": " + one.type());
  EXPECT_THAT(types, ElementsAre("level: double", "ratio: float", "count: int64", "open: bool", "word: string",
                                 "colour: enum Colour", "object: fiona.sdk_test.Ruled"));
  EXPECT_EQ(interface.probes(0).unit(), "m");
  EXPECT_EQ(interface.probes(0).doc(), "how high it stands");
}

class TwoOfAName final : public Component {
 public:
  using Component::Component;
  Provides<Numbers> numbers{*this, "numbers"};
  Probe<bool> probe{*this, "numbers"};
};
class NamedLikeTheHulls final : public Component {
 public:
  using Component::Component;
  Probe<bool> probe{*this, "mode"};
};
class NamedBadly final : public Component {
 public:
  using Component::Component;
  Probe<bool> probe{*this, "a.b"};
};

TEST(ProbeNames, ThatClashAreRefusedWhereTheComponentIsMade) {
  EXPECT_THAT([] { testing::Bench<TwoOfAName> bench; },
              ThrowsMessage<Error>(HasSubstr("two ports, triggers or probes are named 'numbers'")));
  EXPECT_THAT([] { testing::Bench<NamedLikeTheHulls> bench; },
              ThrowsMessage<Error>(HasSubstr("'mode' is a probe that every instance has")));
  EXPECT_THAT([] { testing::Bench<NamedBadly> bench; },
              ThrowsMessage<Error>(HasSubstr("'a.b' is no name for a probe")));
}

TEST_F(Probes, ValueIsReadOnceAlsoWhenNobodyWatches) {
  EXPECT_EQ(meter.hull.read("level").object, nullptr);
  meter->level.set(1.5);
  EXPECT_EQ(read("level"), 1.5);
  meter->colour.set(GREEN);
  EXPECT_EQ(dynamic_cast<const probe::Text&>(*meter.hull.read("colour").object).value(), "GREEN");
}

TEST_F(Probes, OriginIsTheInstancesClockOrWhatTheAuthorSays) {
  advance(50ms);
  meter->level.set(1);
  EXPECT_EQ(meter.hull.read("level").origin, TimePoint(50ms));
  meter->level.set(1, TimePoint(20ms));
  EXPECT_EQ(meter.hull.read("level").origin, TimePoint(20ms));
}

TEST_F(Probes, CountBeyond63BitsStaysAtTheLargest) {
  meter->count.set(~std::uint64_t{0});
  EXPECT_EQ(dynamic_cast<const probe::Integer&>(*meter.hull.read("count").object).value(),
            std::numeric_limits<std::int64_t>::max());
}

TEST_F(Probes, BenchReadsThem) {
  testing::Bench<Meter> bench;
  EXPECT_EQ(bench.probe<double>("level"), std::nullopt);
  EXPECT_EQ(bench.probe<std::string>("mode"), "init");
  EXPECT_EQ(bench.probe<std::uint64_t>("ticker.runs"), 0U);
}

TEST_F(Probes, TapBeginsWithTheValueOfNowAndThenGivesEach) {
  meter->level.set(1);
  tap("level");
  meter->level.set(2);
  meter->level.set(3);
  EXPECT_THAT(kept->numbers(), ElementsAre(1, 2, 3));
}

TEST_F(Probes, ObjectIsSharedAndNotCopied) {
  tap("object");
  meter->object.set(Ruled());
  EXPECT_EQ(kept->take().front().envelope.object, meter.hull.read("object").object);
}

TEST_F(Probes, PrescaleCountsValues) {
  tap("level", {.every = 3});
  for (const double value : {1, 2, 3, 4, 5}) meter->level.set(value);
  EXPECT_THAT(kept->numbers(), ElementsAre(1, 4));
}

TEST_F(Probes, PeriodOfAConditionLeavesOutWhatNobodyHasLost) {
  TapTerms terms = above(2);
  terms.period = 100ms;
  tap("level", std::move(terms));
  for (const double value : {1, 3, 1, 3}) meter->level.set(value);
  advance(100ms);
  const auto late = kept->take();
  ASSERT_EQ(late.size(), 1U);
  EXPECT_EQ(late[0].skipped, 0U);
}

TEST_F(Probes, PeriodSkipsWhatComesBetweenAndGivesTheNewestInTheEnd) {
  tap("level", {.period = 100ms});
  for (const double value : {1, 2, 3, 4}) meter->level.set(value);
  EXPECT_THAT(kept->numbers(), ElementsAre(1));
  advance(100ms);
  const auto late = kept->take();
  ASSERT_EQ(late.size(), 1U);
  EXPECT_EQ(dynamic_cast<const probe::Number&>(*late[0].envelope.object).value(), 4);
  EXPECT_EQ(late[0].skipped, 2U);
  EXPECT_EQ(late[0].number, 2U);
  advance(1s);
  EXPECT_THAT(kept->numbers(), IsEmpty());
}

TEST_F(Probes, ConditionTellsWhenItBecomesTrueAndRearmsWhenItIsFalse) {
  tap("level", above(3));
  for (const double value : {1, 4, 5, 3, 2, 6, 7}) meter->level.set(value);
  EXPECT_THAT(kept->numbers(), ElementsAre(4, 6));
}

TEST_F(Probes, ConditionThatHoldsWhenTheWatchBeginsTellsAtOnce) {
  meter->level.set(4);
  tap("level", above(3));
  EXPECT_THAT(kept->numbers(), ElementsAre(4));
}

TEST_F(Probes, ConditionThatDoesNotFitEndsTheTapAndNotTheComponent) {
  tap("level", {.holds = [](const Object&) -> bool { throw Error(ErrorCode::Usage, "does not compare"); }});
  meter->level.set(1);
  meter->level.set(2);
  EXPECT_EQ(kept->end(), "does not compare");
  EXPECT_EQ(meter.hull.mode(), "init");
}

TEST_F(Probes, ChangesIgnoresWhatStaysTheSame) {
  tap("level", {.changes = true});
  for (const double value : {1, 1, 2, 2, 1}) meter->level.set(value);
  EXPECT_THAT(kept->numbers(), ElementsAre(2, 1));
}

TEST_F(Probes, AgeIsToldOnceAndAgainAfterANewValueHasGrownOld) {
  meter->level.set(1);
  tap("level", {.older_than = 100ms});
  advance(99ms);
  EXPECT_THAT(kept->numbers(), IsEmpty());
  advance(1ms);
  EXPECT_THAT(kept->numbers(), ElementsAre(1));
  advance(1s);
  EXPECT_THAT(kept->numbers(), IsEmpty());
  meter->level.set(2);
  advance(50ms);
  meter->level.set(3);
  advance(99ms);
  EXPECT_THAT(kept->numbers(), IsEmpty());
  advance(1ms);
  EXPECT_THAT(kept->numbers(), ElementsAre(3));
}

TEST_F(Probes, AgeOfWhatWasNeverSetCountsFromTheTap) {
  tap("level", {.older_than = 100ms});
  advance(100ms);
  const auto told = kept->take();
  ASSERT_EQ(told.size(), 1U);
  EXPECT_EQ(told[0].envelope.object, nullptr);
}

TEST_F(Probes, ValueThatIsOldWhenItComesIsToldOnce) {
  advance(1s);
  tap("level", {.older_than = 100ms});
  meter->level.set(1, TimePoint(10ms));
  meter->level.set(2, TimePoint(20ms));
  EXPECT_THAT(kept->numbers(), ElementsAre(1));
}

TEST_F(Probes, NothingRunsWhileNobodyWatches) {
  meter->level.set(1);
  const int before = executor.submitted;
  advance(10s);
  EXPECT_EQ(executor.submitted, before);
  meter.hull.untap(tap("queue_depth"));
  meter.hull.untap(tap("level", {.period = 10ms}));
  meter.hull.untap(tap("level", {.older_than = 10ms}));
  executor.help();
  const int after = executor.submitted;
  advance(10s);
  EXPECT_EQ(executor.submitted, after);
}

TEST_F(Probes, HullSamplesEach200msOrAsOftenAsItIsAsked) {
  tap("queue_depth");
  advance(1s);
  EXPECT_EQ(kept->take().size(), 6U);
  const auto others = std::exchange(kept, std::make_shared<Kept>());
  tap("queue_depth", {.period = 50ms});
  advance(1s);
  EXPECT_EQ(kept->take().size(), 21U);
}

TEST_F(Probes, HullProbeOfAPortAndOfATask) {
  meter.hull.set_mode(kModeActive, 1s);
  meter->numbers.put(Number());
  advance(300ms);
  EXPECT_EQ(read("numbers.age"), 300);
  EXPECT_EQ(read("ticker.runs"), 3);
  EXPECT_EQ(read("ticker.late"), 0);
  EXPECT_EQ(read("numbers_in.queue_depth"), 0);
  EXPECT_EQ(meter.hull.read("numbers_in.age").object, nullptr);
}

TEST_F(Probes, MessagesThatWaitAreSeenInQueueDepth) {
  meter.hull.set_mode(kModeActive, 1s);
  for (int i = 0; i < 5; ++i) {
    meter->numbers_in.inbox()->push({Envelope{std::make_shared<Number>(), 1, clock.now(), 10}, nullptr});
  }
  EXPECT_EQ(read("numbers_in.queue_depth"), 5);
  EXPECT_EQ(read("queue_depth"), 5);
  executor.help();
  EXPECT_EQ(read("numbers_in.queue_depth"), 0);
  EXPECT_THAT(meter->depths, ElementsAre(4, 3, 2, 1, 0));
}

TEST_F(Probes, ModeAndLastErrorAreToldTheMomentTheyChange) {
  tap("mode");
  meter.hull.set_mode(kModeNeutral, 1s);
  meter.hull.set_mode(kModeActive, 1s);
  meter.hull.fail("worn");
  EXPECT_THAT(kept->texts(), ElementsAre("init", "neutral", "active", "failed"));
  EXPECT_EQ(dynamic_cast<const probe::Text&>(*meter.hull.read("last_error").object).value(), "worn");
}

TEST_F(Probes, TapOfAPortGivesWhatItPuts) {
  meter.hull.set_mode(kModeActive, 1s);
  tap("numbers", {.every = 2});
  for (int i = 0; i < 4; ++i) meter->numbers.put(Number());
  EXPECT_EQ(kept->take().size(), 2U);
}

TEST_F(Probes, TapIsToldThatTheInstanceHasEnded) {
  tap("level");
  meter.hull.shut_down(1s);
  EXPECT_EQ(kept->end(), "'meter' was unloaded");
}

TEST_F(Probes, UnknownNameGetsTheNearest) {
  EXPECT_THAT([this] { tap("levle"); }, ThrowsMessage<Error>(HasSubstr("'meter' has no port or probe 'levle'")));
  EXPECT_THAT([this] { tap("numbers.rat"); }, ThrowsMessage<Error>(HasSubstr("numbers.rate")));
  EXPECT_THAT([this] { tap("numbers.queue_depth"); }, ThrowsMessage<Error>(HasSubstr("has no port or probe")));
}

TEST_F(Probes, PortIsNotRead) {
  EXPECT_THAT([this] { meter.hull.read("numbers"); },
              ThrowsMessage<Error>(HasSubstr("meter.numbers is a port: it has no value of now")));
}

class ProbesAndThreads : public ::testing::Test {
 protected:
  ~ProbesAndThreads() override { clock.stop(); }

  SystemClock clock;
  Pool pool{2};
  KeptEvents events;
  Made<Meter> meter{"meter", pool, clock, events};
  std::shared_ptr<Kept> kept = std::make_shared<Kept>();
};

TEST_F(ProbesAndThreads, EachValueOfManyThreadsIsToldOnceAndInOneOrder) {
  meter.hull.tap("count", {}, kept);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([this] {
      for (std::uint64_t i = 0; i < 500; ++i) meter->count.set(i);
    });
  }
  for (auto& thread : threads) thread.join();
  std::uint64_t sequence = 0;
  for (const auto& one : kept->take()) {
    EXPECT_EQ(one.envelope.sequence, ++sequence);
    EXPECT_EQ(one.number, sequence);
  }
  EXPECT_EQ(sequence, 2000U);
}

/// Takes 60 ms for each value: so long the probe is held.
class SlowWatcher final : public Watcher {
 public:
  void value(const Tapped&) override {
    begun_.set_value();
    std::this_thread::sleep_for(60ms);
  }
  void ended(const Error&) override {}
  void wait() { begun_.get_future().wait(); }

 private:
  std::promise<void> begun_;
};

TEST_F(ProbesAndThreads, AWatchOfAnAgeBeginsWithTheValueThatIsThereHoweverLongThatIsWaitedFor) {
  const auto slow = std::make_shared<SlowWatcher>();
  meter.hull.tap("level", {}, slow);
  std::thread setter([&] { meter->level.set(1); });
  slow->wait();
  meter.hull.tap("level", {.older_than = 20ms}, kept);
  setter.join();
  const auto told = kept->take();
  ASSERT_FALSE(told.empty());
  EXPECT_NE(told.front().envelope.object, nullptr) << "it is old, but not none";
}

TEST_F(ProbesAndThreads, AfterDetachNothingIsToldWhileOthersSet) {
  std::atomic<bool> enough{false};
  std::thread setter([&] {
    while (!enough) meter->level.set(1);
  });
  for (int i = 0; i < 100; ++i) {
    const auto tap = meter.hull.tap("level", {.period = Duration(i % 2 * 1000)}, kept);
    const auto sampled = meter.hull.tap("queue_depth", {.period = 1us}, kept);
    meter.hull.untap(tap);
    meter.hull.untap(sampled);
    kept->take();
    std::this_thread::yield();
    EXPECT_TRUE(kept->take().empty());
  }
  enough = true;
  setter.join();
}

}  // namespace
}  // namespace fiona::sdk_test
