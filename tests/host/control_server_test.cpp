// What a console asks for, and does not wait for any more.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <optional>

#include "served_host.hpp"

namespace fiona::host {
namespace {

using conformance::ServedHost;
using conformance::TestConsole;
using testing::HasSubstr;

/// A source, and a sink whose handler takes its time: a change of its mode holds up the changes after it.
class ControlServerTest : public testing::Test {
 protected:
  void SetUp() override {
    console->load("source", host.place(), "source", "period_ms=10");
    console->load("sink", host.place(), "sink", "work_ms=500");
    console->change(TestConsole::wire_of("sink.newest", "source.newest"));
    console->eventually("the handler runs", [this] {
      const auto system = console->snapshot();
      for (const auto& instance : system.instances()) {
        for (const auto& port : instance.ports()) {
          if (instance.name() == "sink" && port.name() == "newest") return port.messages() > 0;
        }
      }
      return false;
    });
  }
  /// Returns at once.
  void hold_up() {
    auto request = console->request();
    for (const char* mode : {"neutral", "active"}) {
      auto& state = *request.mutable_transact()->add_changes()->mutable_state();
      state.set_instance("sink");
      state.set_mode(mode);
    }
    console->send(request);
  }
  static control::Request set_period(TestConsole& by, int period_ms) {
    auto request = by.request();
    *request.mutable_transact()->add_changes() =
        TestConsole::set_of("source", "period_ms=" + std::to_string(period_ms));
    return request;
  }
  std::string period() {
    const auto system = console->snapshot();
    for (const auto& instance : system.instances()) {
      for (const auto& parameter : instance.parameters()) {
        if (instance.name() == "source" && parameter.name() == "period_ms") return parameter.value();
      }
    }
    return "";
  }
  std::string refusal(TestConsole& of) {
    try {
      of.receive();
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  }

  ServedHost host;
  std::optional<TestConsole> console{std::in_place, host};
  TestConsole other{host};
};

TEST_F(ControlServerTest, AChangeThatHasNotBegunByItsDeadlineIsNotMade) {
  hold_up();
  auto late = set_period(other, 20);
  late.set_deadline_ms(1);
  other.send(late);
  EXPECT_THAT(refusal(other), HasSubstr("the changes before it took too long"));
  console->receive();
  EXPECT_EQ(period(), "10");
}

TEST_F(ControlServerTest, AChangeThatIsGivenUpBeforeItsTurnIsNotMade) {
  hold_up();
  const auto change = set_period(other, 20);
  other.send(change);
  auto stop = other.request();
  stop.mutable_unwatch()->set_watch(change.id());
  EXPECT_TRUE(other.ask(stop).has_done());
  EXPECT_THAT(refusal(other), HasSubstr("has given it up"));
  console->receive();
  EXPECT_EQ(period(), "10");
}

TEST_F(ControlServerTest, AChangeOfAConsoleThatHasGoneBeforeItsTurnIsNotMade) {
  hold_up();
  {
    TestConsole goes(host);
    goes.send(set_period(goes, 20));
    auto look = goes.request();
    look.mutable_journal();
    goes.ask(look);  // in order: the change waits by now
  }
  console->receive();
  EXPECT_TRUE(other.ask(set_period(other, 30)).has_done());
  EXPECT_EQ(period(), "30");
  EXPECT_EQ(console->snapshot().instances_size(), 2);
  auto look = other.request();
  look.mutable_journal();
  const auto journal = other.ask(look);
  for (const auto& entry : journal.journal().entries()) EXPECT_THAT(entry.DebugString(), Not(HasSubstr("integer: 20")));
}

TEST_F(ControlServerTest, AChangeThatHasBegunGoesOnAndThatIsTold) {
  hold_up();
  auto stop = console->request();
  stop.mutable_unwatch()->set_watch(stop.id() - 1);
  console->send(stop);
  EXPECT_THAT(refusal(*console), HasSubstr("has begun, and goes on"));
  EXPECT_TRUE(console->receive().has_done());
}

TEST_F(ControlServerTest, ARequestOfTheNumberOfOneThatIsOpenIsRefusedAndThatOneGoesOn) {
  auto request = console->request();
  auto& expect = *request.mutable_expect();
  *expect.mutable_port() = conformance::port_name("source.newest");
  expect.set_field("number");
  expect.set_comparison(control::GREATER_OR_EQUAL);
  expect.mutable_value()->set_integer(100);
  expect.set_within_ms(60'000);
  console->send(request);
  console->send(request);
  EXPECT_THAT(refusal(*console), HasSubstr("a request of this number is open already"));
  EXPECT_TRUE(console->receive().has_met());
}

TEST_F(ControlServerTest, WhatIsWaitedForIsLetGoOf) {
  auto wait = console->request();
  wait.mutable_sleep()->set_duration_ms(3'600'000);
  console->send(wait);
  auto stop = console->request();
  stop.mutable_unwatch()->set_watch(wait.id());
  EXPECT_TRUE(console->ask(stop).has_done());
  EXPECT_TRUE(console->ask(stop).has_done());  // there is nothing any more
}

/// Looks at the system, of which a host is asked for very many at once, and a load behind them.
class Flood {
 public:
  static constexpr int kLooks = 20'000;

  explicit Flood(const ServedHost& host) : socket_(conformance::connected(host.socket())) {
    std::string all;
    control::Request look;
    look.mutable_snapshot();
    for (int i = 1; i <= kLooks; ++i) {
      look.set_id(static_cast<std::uint64_t>(i));
      all += framed(look);
    }
    control::Request load;
    load.set_id(kLooks + 1);
    *load.mutable_transact()->add_changes() = TestConsole::load_of("source", "main", "last");
    all += framed(load);
    // As far as the host takes it.
    for (std::size_t sent = 0; sent < all.size();) {
      const auto size = ::send(socket_.get(), all.data() + sent, all.size() - sent, MSG_NOSIGNAL);
      if (size < 0) break;
      sent += static_cast<std::size_t>(size);
    }
  }
  void say_end() const { ::shutdown(socket_.get(), SHUT_WR); }
  /// Without reading an answer.
  bool is_cut_off() const {
    pollfd end{socket_.get(), POLLRDHUP, 0};
    return ::poll(&end, 1, 40'000) == 1;
  }
  /// All that come.
  int answers() {
    os::MessageStream stream(std::move(socket_));
    control::Reply reply;
    int seen = 0;
    while (seen <= kLooks) {
      if (stream.next(reply)) {
        EXPECT_EQ(reply.id(), static_cast<std::uint64_t>(++seen)) << "not in their order";
      } else if (!stream.wait_readable(std::chrono::steady_clock::now() + std::chrono::seconds(40)) ||
                 !stream.receive()) {
        break;
      }
    }
    return seen;
  }

 private:
  static std::string framed(const control::Request& request) {
    const std::string bytes = request.SerializeAsString();
    const char length[4] = {static_cast<char>(bytes.size()), 0, 0, 0};
    return std::string(length, sizeof length) + bytes;
  }
  os::Descriptor socket_;
};

bool has_last(TestConsole& console) {
  const auto system = console.snapshot();
  return std::any_of(system.instances().begin(), system.instances().end(),
                     [](const auto& one) { return one.name() == "last"; });
}

TEST(ControlServerTurns, WhoAsksForVeryMuchAtOnceDoesNotHoldUpAnother) {
  const ServedHost host;
  Flood flood(host);
  TestConsole other(host);
  EXPECT_FALSE(has_last(other)) << "it had to wait for all of them";
  EXPECT_EQ(flood.answers(), Flood::kLooks + 1);
  EXPECT_TRUE(has_last(other));
}

TEST(ControlServerTurns, NothingMoreIsDoneForOneThatWasCutOff) {
  const ServedHost host;
  TestConsole other(host);
  for (const char* name : {"a", "b", "c", "d", "e", "f", "g", "h"}) other.load("source", "main", name);
  Flood flood(host);
  EXPECT_TRUE(flood.is_cut_off());
  EXPECT_FALSE(has_last(other));
}

TEST(ControlServerTurns, WhatAClientHasSaidBeforeItsEndIsDone) {
  const ServedHost host;
  TestConsole other(host);
  const Flood flood(host);
  flood.say_end();
  other.eventually("the last is made", [&] { return has_last(other); });
}

/// Each life of a component counts what it asks for from 1.
TEST(MastersTest, TheAnswerToOneThatHasGoneIsNotTakenForOneToTheNextOfItsName) {
  ServedHost host;
  TestConsole console(host);
  for (const std::string name : {"lazy", "busy"}) console.load("toiler", "main", name, "stubborn=true");
  const auto begin_by_boss = [&console](const std::string& toiler) {
    control::Change load = TestConsole::load_of("boss", "main", "boss");
    load.mutable_load()->add_rights("master");
    console.change(load);
    console.set("boss", "call=state second=rest deadline_ms=20000 go=1 first=" + toiler);
    console.eventually("it is under way", [&] { return console.instance(toiler).has_pending(); });
  };
  begin_by_boss("lazy");
  console.unload("boss");
  begin_by_boss("busy");
  console.set("lazy", "stubborn=false");
  console.eventually("the first is answered", [&] { return console.instance("lazy").mode() == "rest"; });
  console.set("busy", "stubborn=false");
  console.eventually("its own is answered", [&] { return !console.read("boss.ended").empty(); });
  EXPECT_THAT(console.read("boss.ended"), HasSubstr("busy is rest"));
}

}  // namespace
}  // namespace fiona::host
