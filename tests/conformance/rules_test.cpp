// Rules that all patterns share (docs/patterns.md, Shared rules).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using Rules = OverTransports;

TEST_P(Rules, AClientPortIsUnwiredWaitingConnectedOrLostWithAReasonAndATime) {
  system.load_client("sink", "sink");
  const auto port = [&] { return system.port("sink.leased"); };
  // Of the time since it is what it is, so that one can see that the next one counts anew.
  const auto grown_s = [&] {
    system.eventually("the time grows", [&] { return port().since_s() > 1; });
    return port().since_s();
  };
  EXPECT_EQ(port().connection(), control::UNWIRED);
  EXPECT_EQ(port().reason(), "not wired");
  double before_s = grown_s();
  system.wire("sink.leased", "source.leased");
  EXPECT_EQ(port().connection(), control::WAITING);
  EXPECT_EQ(port().reason(), "there is no instance 'source' yet");
  EXPECT_LT(port().since_s(), before_s);
  before_s = grown_s();
  system.load_provider("source", "source", "period_ms=1");
  EXPECT_EQ(port().connection(), control::CONNECTED);
  EXPECT_LT(port().since_s(), before_s);
  before_s = grown_s();
  system.set("source", "count=5");
  system.eventually("lost", [&] { return port().connection() == control::LOST; });
  EXPECT_EQ(port().reason(), "source.leased has been silent for 100 ms");
  EXPECT_LT(port().since_s(), before_s);
  before_s = grown_s();
  system.unwire("sink.leased");
  EXPECT_EQ(port().connection(), control::UNWIRED);
  EXPECT_LT(port().since_s(), before_s);
}

TEST_P(Rules, AStartNeverBlocksOnAMissingPeer) {
  system.load_client("caller", "caller", "neutral");
  for (const std::string port : {"samples", "echo", "bell", "orders"}) system.wire("caller." + port, "nobody." + port);
  system.state("caller", "active");
  EXPECT_EQ(system.instance("caller").mode(), "active");
  for (const std::string port : {"samples", "echo", "bell", "orders"}) {
    EXPECT_EQ(system.port("caller." + port).connection(), control::WAITING) << port;
    EXPECT_TRUE(system.port("caller." + port).optional()) << port;
  }
}

TEST_P(Rules, AStartNeverBlocksOnTheMissingPeerOfAPortThatIsRequired) {
  system.load_client("asker", "unwired");
  EXPECT_EQ(system.instance("unwired").mode(), "active");
  EXPECT_EQ(system.port("unwired.echo").connection(), control::UNWIRED);
  system.load_client("asker", "asker", "neutral");
  EXPECT_FALSE(system.port("asker.echo").optional());
  system.wire("asker.echo", "nobody.echo");
  const auto outcomes = system.watch("asker.outcome");
  system.state("asker", "active");
  EXPECT_EQ(system.instance("asker").mode(), "active");
  EXPECT_EQ(system.port("asker.echo").connection(), control::WAITING);
  EXPECT_EQ(system.wait_for(outcomes, [](const auto&) { return true; }).value(),
            static_cast<double>(Outcome::Disconnected))
      << "it works, and is told";
  system.load_provider("answerer", "nobody");
  system.wait_for(outcomes, [](const auto& one) { return one.value() == static_cast<double>(Outcome::Ok); });
}

/// A listener that hears messages of every pattern, many at once.
class Crowd : public OverTransports {
 protected:
  void SetUp() override {
    system.load_client("listener", "listener");
    system.load_provider("source", "source", "neutral period_ms=0.4");
    system.load_provider("source", "other", "period_ms=0.7");
    system.load_provider("asker", "asker", "neutral period_ms=1");
    system.wire("listener.samples", "source.newest");
    system.wire("listener.others", "other.newest");
    system.wire("listener.bell", "source.bell");
    system.wire("source.orders", "listener.orders");
    system.wire("asker.echo", "listener.echo");
    system.state("source", "active");
    system.state("asker", "active");
    ASSERT_EQ(system.call("listener.listen").outcome(), "ok");
    for (const std::string kind : {"samples", "others", "orders", "questions", "rings"}) {
      system.eventually(kind, [&] { return system.read("listener." + kind + "_heard").value() >= 300; });
    }
  }
};

TEST_P(Crowd, MessagesOfEveryPatternComeInTheOrderInWhichTheyLeft) {
  EXPECT_FALSE(system.read("listener.disorder").has_value) << system.read("listener.disorder").payload();
}

TEST_P(Crowd, NothingOfAnInstanceRunsWhileSomethingElseOfItDoes) {
  EXPECT_FALSE(system.read("listener.overlaps").has_value) << system.read("listener.overlaps").value();
}

TEST_P(Rules, ACallThatFailsAtOnceLeavesRoomForOthers) {
  system.load_client("caller", "caller");
  const auto outcomes = system.watch("caller.outcome");
  system.set("caller", "call=ask_without_end go=1");
  system.set("caller", "call=latest go=2");
  const auto ended = system.wait_for(outcomes, [](const auto& one) { return one.number() == 1; });
  EXPECT_GT(std::stoi(ended.payload()), 0);
}

TEST_P(Rules, NothingThatIsHandedOverWaitsForAHandler) {
  system.load_client("sink", "sink", "work_ms=100");
  system.load_provider("source", "source", "neutral period_ms=1 count=100");
  system.wire("sink.each", "source.newest");
  system.wire("source.orders", "sink.orders");
  system.state("source", "active");
  system.eventually(
      "all put and sent", [&] { return system.port("source.orders").messages() == 100; }, std::chrono::seconds(5));
  EXPECT_LT(system.port("sink.each").messages(), 60U);
}

TEST_P(Rules, WhatBreaksItsRuleIsCountedAndGoesNoFurther) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral period_ms=1 count=20 value=2e9");
  system.wire("sink.each", "source.newest");
  system.wire("source.orders", "sink.orders");
  system.state("source", "active");
  system.eventually("all refused", [&] {
    return system.port("source.newest").refused() == 20 && system.port("source.orders").refused() == 20;
  });
  system.set("source", "value=1 count=21");
  system.state("source", "neutral");
  system.state("source", "active");
  system.eventually("a sound one", [&] {
    return system.port("sink.each").messages() == 1 && system.port("sink.orders").messages() == 1;
  });
}

FIONA_OVER_EVERY_TRANSPORT(Crowd);

}  // namespace
}  // namespace fiona::conformance
