// A component that changes its system, alone on the bench.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "fiona/describe.hpp"
#include "fiona/plugin.hpp"
#include "fiona/pool.hpp"
#include "fiona/testing/bench.hpp"
#include "support.hpp"

namespace fiona::sdk_test {

using namespace std::chrono_literals;

/// Asks once it is active.
class Asker : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) hull().spawn(choose(), [] {});
  }

 protected:
  virtual Async<> choose() = 0;

  Master master_{*this};
  Probe<std::string> ended_{*this, "ended"};
};

class Chooser final : public Asker {
 public:
  using Asker::Asker;

 private:
  Async<> choose() override {
    WireChoice choice;
    choice.otherwise = {"wifi.location"};
    choice.every = 2;
    choice.hold = 500ms;
    Changes changes;
    changes.wire("nav.location", "fusion.location", choice)
        .set("wifi", "period", 200, "ms")
        .set("wifi", "strict", true)
        .state("gps", "neutral");
    const auto done = co_await master_.make(std::move(changes), 1s);
    ended_.set(std::string(to_string(done.outcome())) + done.reason());
  }
};

/// Looks at satellites until it is told that there is nothing more to be seen.
class Looker final : public Asker {
 public:
  using Asker::Asker;

 private:
  Async<> choose() override {
    const WatchTerms terms{.every = 2, .period = 50ms, .when = when::below(4)};
    auto few = co_await master_.watch("gps.satellites.rate", terms);
    std::string text;
    while (true) {
      const auto seen = co_await few->next(1s);
      text +=
          seen ? std::to_string(value_of<int>(*seen).value_or(-1)) + " " : std::string(to_string(seen.outcome())) + " ";
      ended_.set(text);
      if (!seen && seen.outcome() != Outcome::Timeout) co_return;
    }
  }
};

/// Names what is named in Latin-1.
class LatinChooser final : public Asker {
 public:
  using Asker::Asker;

 private:
  Async<> choose() override {
    const auto done = co_await master_.wire(
        "K\xfc"
        "che.place",
        "gps.location");
    ended_.set(std::string(to_string(done.outcome())) + ": " + done.reason());
  }
};

/// Asks when its own time is over.
class TooLate final : public Asker {
 public:
  using Asker::Asker;

 private:
  Async<> choose() override {
    ended_.set(std::string(to_string((co_await master_.make(Changes().state("gps", "neutral"), -1s)).outcome())));
  }
};

class TwiceMaster final : public Component {
 public:
  using Component::Component;

 private:
  Master one_{*this};
  Master two_{*this};
};

namespace {

TEST(Master, AsksForAllChangesAsOneTransactionAndIsTold) {
  testing::Bench<Chooser> bench;
  bench.start();
  const auto requests = bench.take_requests();
  ASSERT_EQ(requests.size(), 1U);
  const auto& changes = requests[0].transact().changes();
  ASSERT_EQ(changes.size(), 4);
  EXPECT_EQ(changes[0].wire().client().instance(), "nav");
  EXPECT_EQ(changes[0].wire().client().port(), "location");
  EXPECT_EQ(changes[0].wire().alternatives(0).instance(), "wifi");
  EXPECT_EQ(changes[0].wire().prescale(), 2U);
  EXPECT_EQ(changes[0].wire().hold_ms(), 500);
  EXPECT_EQ(changes[1].set().parameters(0).value().integer(), 200);
  EXPECT_EQ(changes[1].set().parameters(0).value().unit(), "ms");
  EXPECT_TRUE(changes[2].set().parameters(0).value().flag());
  EXPECT_EQ(changes[3].state().mode(), "neutral");
  EXPECT_LT(changes[3].state().within_ms(), 1000) << "its refusal arrives before the caller gives up";
  bench.advance(1ms);
  EXPECT_EQ(bench.probe<std::string>("ended"), "ok");
}

control::Sample sample_with(std::uint64_t number, const google::protobuf::Message& value) {
  control::Sample sample;
  sample.set_number(number);
  sample.set_type(value.GetDescriptor()->full_name());
  sample.set_object(value.SerializeAsString());
  return sample;
}

TEST(Master, WatchesByTheTermsThatAreNamedAndFetchesOneValueAfterTheOther) {
  testing::Bench<Looker> bench;
  bench.start();
  bench.advance(1ms);
  auto requests = bench.take_requests();
  ASSERT_EQ(requests.size(), 2U);
  const control::Watch& watch = requests[0].watch();
  EXPECT_EQ(watch.port().instance(), "gps");
  EXPECT_EQ(watch.port().port(), "satellites.rate");
  EXPECT_EQ(watch.prescale(), 2U);
  EXPECT_EQ(watch.min_period_ms(), 50);
  EXPECT_EQ(watch.condition().compared().comparison(), control::LESS);
  EXPECT_EQ(watch.condition().compared().value().number(), 4);
  EXPECT_EQ(requests[1].next().after(), 0U);

  probe::Integer three;
  three.set_value(3);
  EXPECT_TRUE(bench.show(sample_with(7, three)));
  bench.advance(1ms);
  probe::Number two;
  two.set_value(2.5);
  EXPECT_TRUE(bench.show(sample_with(8, two)));
  bench.advance(1ms);
  probe::Text text;
  text.set_value("x");
  EXPECT_TRUE(bench.show(sample_with(9, text)));
  bench.advance(1ms);
  EXPECT_EQ(bench.probe<std::string>("ended"), "3 2 -1 ") << "a text is no number";
  requests = bench.take_requests();
  ASSERT_EQ(requests.size(), 3U);
  EXPECT_EQ(requests[0].next().after(), 7U) << "what has arrived is kept no more";
  EXPECT_EQ(requests[2].next().after(), 9U);
}

TEST(Master, GoesOnToWatchAfterItsDeadlineAndItsMode) {
  testing::Bench<Looker> bench;
  bench.start();
  bench.advance(2500ms);
  EXPECT_EQ(bench.probe<std::string>("ended"), "timeout timeout ");
  for (const auto& request : bench.take_requests()) EXPECT_EQ(request.next().after(), 0U) << "nothing has arrived";
}

TEST(Master, LetsGoOfWhatItWatchesWithItself) {
  std::vector<control::Request> requests;
  {
    testing::Bench<Looker> bench;
    bench.start();
    bench.advance(1ms);
    bench.take_requests();
    EXPECT_FALSE(bench.hull().shut_down(1s)) << "it has ended";
    requests = bench.take_requests();
  }
  ASSERT_EQ(requests.size(), 1U);
  EXPECT_EQ(requests[0].unwatch().watch(), 1U);
}

TEST(Master, IsToldWhyItWasRefused) {
  testing::Bench<Chooser> bench;
  bench.refuse_with("there is no instance 'nav'");
  bench.start();
  bench.advance(1ms);
  EXPECT_EQ(bench.probe<std::string>("ended"), "rejectedthere is no instance 'nav'");
}

TEST(Master, AsksForNothingWhoseNamesTheHostCouldNotRead) {
  testing::Bench<LatinChooser> bench;
  bench.start();
  bench.advance(1ms);
  EXPECT_TRUE(bench.take_requests().empty());
  EXPECT_EQ(bench.probe<std::string>("ended"), "rejected: what it asks for holds text that is no UTF-8");
}

class CountedRequests final : public HullEvents {
 public:
  void mode_changed(const std::string&, const std::string&, const std::string&) override {}
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string&, LogLevel, std::string_view) override {}
  void asked(const std::string&, std::uint64_t, const control::Request&) override { ++count; }
  std::atomic<int> count{0};
};

TEST(Master, AsksForNothingWhoseTimeIsOver) {
  SystemClock clock;
  Pool pool(2);
  CountedRequests requests;
  {
    Made<TooLate> late("late", pool, clock, requests);
    late.hull.set_mode(kModeActive, kLimit);
    const auto end = std::chrono::steady_clock::now() + kLimit;
    while (!late.hull.read("ended").object && std::chrono::steady_clock::now() < end) std::this_thread::yield();
    const auto ended = std::dynamic_pointer_cast<const probe::Text>(late.hull.read("ended").object);
    ASSERT_TRUE(ended);
    EXPECT_EQ(ended->value(), "timeout");
  }
  EXPECT_EQ(requests.count, 0);
  clock.stop();
}

TEST(Master, StandsInTheInterface) {
  Plugin plugin;
  plugin.add<Chooser>("chooser");
  EXPECT_EQ(describe(plugin).components(0).rights(0), "master");
}

TEST(Master, IsAMemberOnce) {
  try {
    testing::Bench<TwiceMaster> bench;
    FAIL() << "it was made";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "a component is master once");
  }
}

}  // namespace
}  // namespace fiona::sdk_test
