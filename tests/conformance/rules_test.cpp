// Rules that all patterns share (docs/patterns.md, Shared rules).
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <atomic>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

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
    double now_s = 0;
    system.eventually("the time grows", [&] { return (now_s = port().since_s()) > 1; });
    return now_s;
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
  system.eventually("connected", [&] { return port().connection() == control::CONNECTED; });
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

/// A call by hand, and how often it was answered.
struct CountedCall {
  std::atomic<int> answers{0};
  control::Reply reply;  ///< the first
};

/// A listener that hears messages of every pattern, many at once.
class Crowd : public OverTransports {
 protected:
  std::shared_ptr<CountedCall> begin_call(const std::string& trigger, std::uint64_t client, std::uint64_t number) {
    control::Call request;
    *request.mutable_target() = port_name("listener." + trigger);
    add_arguments("number=" + std::to_string(number), *request.mutable_arguments());
    request.set_within_ms(60'000);
    auto call = std::make_shared<CountedCall>();
    system.system().call(client, number, request, [call](control::Reply reply) {
      if (call->answers == 0) call->reply = std::move(reply);
      ++call->answers;
    });
    return call;
  }
  /// It was run as the call of this number, and before it this many less one.
  void expect_run(const control::Called& called, std::uint64_t number, std::uint64_t run) {
    const auto result = system.system().types().make(called.result().type());
    ASSERT_TRUE(result) << called.outcome() << " " << called.reason();
    result->ParseFromString(called.result().object());
    const auto& type = *result->GetDescriptor();
    const auto& reflect = *result->GetReflection();
    EXPECT_EQ(reflect.GetUInt64(*result, type.FindFieldByName("number")), run);
    EXPECT_EQ(reflect.GetString(*result, type.FindFieldByName("payload")), std::to_string(number));
  }
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

/// Of a trigger that answers at once, and of one that is a coroutine.
TEST_P(Crowd, EachCallOfATriggerIsRunOnceInItsOrderAndIsGivenItsOwnResult) {
  constexpr std::uint64_t kRounds = 3;
  constexpr std::uint64_t kClients = 20;
  constexpr std::uint64_t kCallsOfEach = 3;  // at once: together fewer than a trigger takes
  for (const std::string trigger : {"count_call", "count_later"}) {
    std::uint64_t number = 0;
    std::set<std::uint64_t> runs;
    for (std::uint64_t round = 0; round < kRounds; ++round) {
      std::vector<std::shared_ptr<CountedCall>> calls;
      for (std::uint64_t i = 0; i < kClients * kCallsOfEach; ++i)
        calls.push_back(begin_call(trigger, 1 + i % kClients, number + i + 1));
      for (const auto& call : calls) {
        system.eventually("the end of the call", [&] { return call->answers > 0; });
        const auto& called = call->reply.called();
        EXPECT_EQ(called.outcome(), "ok") << called.reason();
        ++number;
        expect_run(called, number, number);
        EXPECT_TRUE(runs.insert(called.run()).second) << "a number of the run that another has";
      }
      for (const auto& call : calls) EXPECT_EQ(call->answers, 1);
    }
  }
  EXPECT_FALSE(system.read("listener.disorder").has_value) << system.read("listener.disorder").payload();
  EXPECT_FALSE(system.read("listener.overlaps").has_value) << system.read("listener.overlaps").value();
}

TEST_P(Crowd, OfMoreCallsThanATriggerTakesEachIsRunOrRejectedAndToldWhich) {
  constexpr std::uint64_t kCalls = 200;
  std::vector<std::shared_ptr<CountedCall>> calls;
  for (std::uint64_t i = 1; i <= kCalls; ++i) calls.push_back(begin_call("count_later", i, i));
  std::uint64_t run = 0;
  std::uint64_t number = 0;
  for (const auto& call : calls) {
    ++number;
    system.eventually("the end of the call", [&] { return call->answers > 0; });
    const auto& called = call->reply.called();
    if (called.outcome() == "ok") {
      expect_run(called, number, ++run);
    } else {
      EXPECT_EQ(called.outcome() + ": " + called.reason(), "rejected: too many calls of 'count_later' are under way");
    }
  }
  EXPECT_GE(run, 64U);
  for (const auto& call : calls) EXPECT_EQ(call->answers, 1);
}

/// Of slots, handlers and waits, each by several on strands of their own, of a probe that a thread sets, and by who
/// watches.
TEST_P(Crowd, WhatIsReadWhileItIsPutIsWhole) {
  const std::vector<std::string> ways{"each", "newest", "slot", "updates"};
  const std::vector<std::string> inspectors{"first", "second", "third"};
  system.load_provider("stamper", "stamper", "period_ms=1");
  for (const auto& inspector : inspectors) {
    system.load_client("inspector", inspector);
    for (const auto& way : ways) system.wire(inspector + "." + way, "stamper.samples");
  }
  const std::uint64_t watches[] = {system.watch("stamper.samples"), system.watch("stamper.shows")};
  for (const auto& inspector : inspectors) {
    for (const auto& way : ways) {
      const std::string seen = inspector + "." + way + "_seen";
      system.eventually(seen, [&] { return system.read(seen).value() >= 200; });
    }
  }
  for (const auto& inspector : inspectors) EXPECT_FALSE(system.read(inspector + ".torn").has_value) << inspector;
  for (const std::uint64_t watch : watches) {
    const auto seen = system.take(watch);
    EXPECT_GT(seen.size(), 100U);
    for (const auto& one : seen) {
      EXPECT_EQ(one.value(), static_cast<double>(one.number()));
      EXPECT_EQ(one.sent_ns(), static_cast<std::int64_t>(one.number()));
      std::string stamped;
      for (int i = 0; i < 8; ++i) stamped += static_cast<char>(one.number() >> (8 * i) & 0xffU);
      for (std::size_t at = 0; at < one.payload().size(); at += 8) EXPECT_EQ(one.payload().substr(at, 8), stamped);
    }
  }
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

/// Whom a provider sends to, and whom its status shows: those that are wired to it, of which some may be lost. The two
/// providers' samples differ in their size.
class ClientsOfAPort : public OverTransports {
 protected:
  void SetUp() override {
    system.load_provider("source", "one", "period_ms=2 payload=1");
    system.load_provider("source", "two", "period_ms=2 payload=2");
    for (const std::string name : {"red", "green"}) system.load_client("sink", name);
    system.load_in("apart", "sink", "blue");
    for (const auto& name : sinks) reports[name] = system.watch(name + ".report");
  }
  std::set<std::string> shown(const std::string& provider) {
    std::set<std::string> names;
    const auto port = system.port(provider + ".newest");
    for (const auto& client : port.clients()) {
      EXPECT_EQ(client.port(), "each");
      const auto end = system.port(client.instance() + ".each");
      EXPECT_EQ(end.peer().instance(), provider) << client.instance();
      if (end.connection() != control::CONNECTED) continue;
      EXPECT_TRUE(names.insert(client.instance()).second) << client.instance() << " twice";
    }
    return names;
  }
  /// Those that get what it puts.
  std::set<std::string> served(const std::string& provider, const std::string& size) {
    for (const auto& [name, watch] : reports) system.take(watch);
    const auto put = system.port(provider + ".newest").messages();
    system.eventually("it puts", [&] { return system.port(provider + ".newest").messages() > put + 20; });
    std::set<std::string> names;
    for (const auto& [name, watch] : reports) {
      for (const auto& one : system.take(watch)) {
        if (one.payload() == size) names.insert(name);
      }
    }
    return names;
  }
  void expect_clients(const std::set<std::string>& of_one, const std::set<std::string>& of_two) {
    const std::pair<std::string, std::set<std::string>> all[] = {{"one", of_one}, {"two", of_two}};
    for (const auto& [provider, expected] : all) {
      EXPECT_EQ(shown(provider), expected) << provider;
      system.eventually(provider + " has as many subscribers", [&, &name = provider, &clients = expected] {
        return system.read(name + ".subscribers").value() == static_cast<double>(clients.size());
      });
      const std::string size = provider == "one" ? "1" : "2";
      // What was put before the change may still be on its way.
      system.eventually(provider + " sends to these",
                        [&, &name = provider, &clients = expected] { return served(name, size) == clients; });
    }
  }

  const std::vector<std::string> sinks{"red", "green", "blue"};
  std::map<std::string, std::uint64_t> reports;
};

TEST_P(ClientsOfAPort, AreThoseThatItSendsToAfterEachChange) {
  expect_clients({}, {});
  for (const auto& name : sinks) system.wire(name + ".each", "one.newest");
  expect_clients({"red", "green", "blue"}, {});
  for (const std::string name : {"red", "blue"}) system.wire(name + ".each", "two.newest");
  expect_clients({"green"}, {"red", "blue"});
  system.wire("blue.each", "two.newest", 2);
  expect_clients({"green"}, {"red", "blue"});
  system.wire("blue.each", "one.newest");
  expect_clients({"green", "blue"}, {"red"});
  system.unwire("green.each");
  expect_clients({"blue"}, {"red"});
  system.unload("red");
  expect_clients({"blue"}, {});
}

TEST_P(ClientsOfAPort, AreWithoutThoseWhoseGroupHasDied) {
  for (const auto& name : sinks) system.wire(name + ".each", "one.newest");
  expect_clients({"red", "green", "blue"}, {});
  ::kill(system.group("apart").process(), SIGKILL);
  system.eventually("it has failed", [&] { return system.instance("blue").mode() == "failed"; });
  expect_clients({"red", "green"}, {});
  EXPECT_EQ(system.port("one.newest").clients_size(), 3) << "its wire is there for when it comes back";
  EXPECT_EQ(system.port("blue.each").connection(), control::LOST);
  system.unwire("blue.each");
  EXPECT_EQ(system.port("one.newest").clients_size(), 2);
  expect_clients({"red", "green"}, {});
}

FIONA_OVER_EVERY_TRANSPORT(ClientsOfAPort);
FIONA_OVER_EVERY_TRANSPORT(Crowd);

}  // namespace
}  // namespace fiona::conformance
