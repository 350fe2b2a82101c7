// What a component may write, and what becomes of it: handlers, calls, timers, coroutines of its own, names, its end.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <future>
#include <limits>
#include <optional>
#include <stdexcept>

#include "fiona/local_wire.hpp"
#include "fiona/pool.hpp"
#include "fiona/sdk_test/objects.fiona.hpp"
#include "fiona/testing/bench.hpp"
#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::ThrowsMessage;

Ruled named(const std::string& name, double length = 1) {
  Ruled object;
  object.set_name(name);
  object.set_length(length);
  return object;
}

/// Runs `work` on the component's strand.
template <class C, class F>
void on_strand(testing::Bench<C>& bench, F work) {
  bench.hull().strand().call([&] { work(bench.component()); }, kLimit);
}

// ---- handlers -------------------------------------------------------------------------------------------------

/// Answers in each of the ways that a handler may have, as the name of the question says.
class Answering final : public Component {
 public:
  using Component::Component;
  std::optional<Reply<Ruled>> kept;

 private:
  static void throw_as(const Ruled& question) {
    if (question.name() == "err") throw Error(ErrorCode::NotFound, "there is none");
    if (question.name() == "std") throw std::runtime_error("it broke");
  }
  Ruled at_once(const Ruled& question) const {
    throw_as(question);
    return question;
  }
  Async<Ruled> later(const Ruled& question) {
    throw_as(question);
    co_return question;
  }
  void by_reply(const Ruled& question, Reply<Ruled> reply) {
    if (question.name() == "drop") return;
    if (question.length() == 2) kept = std::move(reply);
    throw_as(question);
    reply.answer(question);
  }

  Provides<Questions> at_once_{*this, "at_once", &Answering::at_once};
  Provides<Questions> later_{*this, "later", &Answering::later};
  Provides<Questions> by_reply_{*this, "by_reply", &Answering::by_reply};
};

class QueryHandler : public ::testing::TestWithParam<std::string> {
 protected:
  testing::Bench<Answering> bench;
};

TEST_P(QueryHandler, ThatThrowsErrorRejectsTheRequestWithItsTextAndGoesOn) {
  bench.start();
  const auto answer = bench.ask<Questions>(GetParam(), named("err"));
  EXPECT_EQ(answer.outcome(), Outcome::Rejected);
  EXPECT_EQ(answer.reason(), "there is none");
  EXPECT_EQ(bench.mode(), kModeActive);
  EXPECT_TRUE(bench.ask<Questions>(GetParam(), named("ok")).ok());
}

TEST_P(QueryHandler, ThatThrowsAnythingElseFailsItsInstanceAndEndsTheRequest) {
  bench.start();
  const auto answer = bench.ask<Questions>(GetParam(), named("std"));
  EXPECT_EQ(answer.outcome(), Outcome::Rejected);
  EXPECT_EQ(answer.reason(), Reply<Ruled>::kFailed);
  EXPECT_EQ(bench.reason(), "it broke");
}

INSTANTIATE_TEST_SUITE_P(Each, QueryHandler, ::testing::Values("at_once", "later", "by_reply"),
                         [](const auto& tested) { return tested.param; });

TEST(QueryHandlers, ThatKeepTheReplyAndThrowErrorRejectAllTheSame) {
  testing::Bench<Answering> bench;
  bench.start();
  EXPECT_EQ(bench.ask<Questions>("by_reply", named("err", 2)).reason(), "there is none");
  EXPECT_EQ(bench.ask<Questions>("by_reply", named("drop")).reason(), "no answer");
}

/// Handlers that change nothing of their component, and one of an event that is a coroutine.
class Onlooker final : public Component {
 public:
  using Component::Component;
  mutable std::vector<std::string> seen;
  Requires<Alarms> alarms{*this, "alarms", &Onlooker::on_alarm};
  Requires<Numbers> slot{*this, "slot"};

 private:
  void on_number(const Number& number) const { seen.push_back("number " + std::to_string(number.value())); }
  void on_received(const Received<Number>& number) const {
    seen.push_back("received " + std::to_string(number->value()));
  }
  void on_order(const Number& number) const { seen.push_back("order " + std::to_string(number.value())); }
  Async<> on_alarm(const Ruled& alarm) {
    static_cast<void>(co_await slot.wait_update(10ms));
    seen.push_back("alarm " + alarm.name());
  }
  Requires<Numbers> numbers_{*this, "numbers", &Onlooker::on_number};
  Requires<Numbers> received_{*this, "received", &Onlooker::on_received};
  Provides<Orders> orders_{*this, "orders", &Onlooker::on_order};
};

/// What its client hears of a request.
struct Heard final : ReplySink {
  void answer(Outcome result, std::string why, std::shared_ptr<const Object>) override {
    if (text.empty()) text = std::string(to_string(result)) + ": " + why;
  }
  std::string text;
};

TEST(LocalWires, EndWhatIsOpenOnThemWhenTheyAreCut) {
  testing::Bench<Answering> bench;
  bench.start();
  Inbox& inbox = *dynamic_cast<ProvidedPort&>(*bench.hull().find_port("by_reply")).inbox();
  const auto wire = std::make_shared<LocalWire>("client.q<component.by_reply", inbox);
  std::vector<std::shared_ptr<Heard>> heard;
  for (int i = 0; i < 300; ++i) {
    heard.push_back(std::make_shared<Heard>());
    auto request = std::make_shared<Ruled>(named("keep", i < 299 ? 1 : 2));
    EXPECT_EQ(wire->deliver({Envelope{std::move(request), 1, bench.now(), 10}, heard.back()}), Outcome::Ok);
    bench.advance(1ms);
  }
  wire->cut("the provider hangs");
  EXPECT_EQ(heard.front()->text, "ok: ");
  EXPECT_EQ(heard.back()->text, "disconnected: the provider hangs");
  EXPECT_TRUE(bench.component().kept->abandoned());
}

/// Puts to itself.
class Talking final : public Component {
 public:
  using Component::Component;
  std::vector<const Number*> handled;
  Provides<Numbers> numbers{*this, "numbers"};
  Requires<Numbers> each{*this, "each", &Talking::on_number};
  Requires<Numbers> newest{*this, "newest", &Talking::on_number, {.delivery = Delivery::Newest}};
  Requires<Numbers> slot{*this, "slot"};

 private:
  void on_number(const Number& number) { handled.push_back(&number); }
};

TEST(LocalWires, GiveEachSubscriberTheVeryObjectThatWasPut) {
  testing::Bench<Talking> bench;
  bench.start();
  const auto number = std::make_shared<const Number>(numbered(1));
  on_strand(bench, [&](Talking& talking) {
    for (RequiredPort* port : std::initializer_list<RequiredPort*>{&talking.each, &talking.newest, &talking.slot})
      talking.numbers.attach(std::make_shared<LocalWire>(port->full_name(), port->end_for("bench"), 1));
    talking.numbers.put(number);
  });
  bench.advance(1ms);
  EXPECT_THAT(bench.component().handled, ElementsAre(number.get(), number.get()));
  on_strand(bench, [&](Talking& talking) { EXPECT_EQ(&**talking.slot.latest(), number.get()); });
}

TEST(Handlers, MayBeConst) {
  testing::Bench<Onlooker> bench;
  bench.start();
  bench.put<Numbers>("numbers", numbered(1));
  bench.put<Numbers>("received", numbered(2));
  bench.put<Orders>("orders", numbered(3));
  EXPECT_THAT(bench.component().seen, ElementsAre("number 1", "received 2", "order 3"));
}

TEST(Handlers, OfAnEventMayBeCoroutines) {
  testing::Bench<Onlooker> bench;
  bench.start();
  Async<> activation = [](Onlooker& onlooker) -> Async<> {
    static_cast<void>(co_await onlooker.alarms.activate(EventMode::Continuous, named("any")));
  }(bench.component());
  on_strand(bench, [&](Onlooker&) { bench.hull().spawn(std::move(activation)); });
  EXPECT_EQ(bench.fire<Alarms>("alarms", named("fire")), 1U);
  EXPECT_THAT(bench.component().seen, IsEmpty());
  bench.advance(10ms);
  EXPECT_THAT(bench.component().seen, ElementsAre("alarm fire"));
}

TEST(Latest, OfAPortWithAHandlerSaysThatItHasOne) {
  class Asks final : public Component {
   public:
    using Component::Component;
    void on_number(const Number&) {}
    Requires<Numbers> numbers{*this, "numbers", &Asks::on_number};
  };
  testing::Bench<Asks> bench;
  bench.start();
  bench.put<Numbers>("numbers", numbered(1));
  on_strand(bench, [](Asks& asks) {
    const auto latest = asks.numbers.latest();
    EXPECT_EQ(latest.outcome(), Outcome::Rejected);
    EXPECT_EQ(latest.reason(), "the port has a handler: what arrives goes there");
  });
}

// ---- calls ----------------------------------------------------------------------------------------------------

class Calling final : public Component {
 public:
  using Component::cancel_calls;
  using Component::Component;
  using Component::spawn;
  Async<> ask(Duration within) {
    const auto answer = co_await questions.query(named("any"), within);
    ended.push_back(std::string(to_string(answer.outcome())) + answer.reason());
  }
  Async<> wait(Duration within) {
    const auto next = co_await slot.wait_update(within);
    ended.push_back(std::string(to_string(next.outcome())) + next.reason());
  }
  Async<> put_paced(TimePoint origin) {
    ended.push_back(std::string(to_string(co_await numbers.put(numbered(1), origin, 10ms))));
  }

  std::vector<std::string> ended;
  Async<> wait_newest(Duration within) {
    const auto next = co_await handled.wait_update(within);
    ended.push_back(std::string(to_string(next.outcome())) + std::to_string(next ? (*next)->value() : 0));
  }
  void on_number(const Number&) {}

  Requires<Questions> questions{*this, "questions"};
  Requires<Questions> failing{*this, "failing", {.at_rewire = AtRewire::Fail}};
  Requires<Orders> orders{*this, "orders"};
  Requires<Numbers> slot{*this, "slot"};
  Requires<Numbers> handled{*this, "handled", &Calling::on_number, {.delivery = Delivery::Newest}};
  Provides<Numbers> numbers{*this, "numbers"};
};

class ComponentsCalls : public ::testing::Test {
 protected:
  ComponentsCalls() { bench.start(); }
  std::vector<std::string> ended() { return std::exchange(bench.component().ended, {}); }
  testing::Bench<Calling> bench;
};

TEST_F(ComponentsCalls, MayHaveNoDeadlineAtAll) {
  bench.advance(1s);
  on_strand(bench, [](Calling& calling) {
    calling.spawn(calling.ask(Duration::max()));
    calling.spawn(calling.wait(Duration::max() - 1ns));
  });
  bench.advance(1h);
  EXPECT_THAT(ended(), IsEmpty());
  bench.put<Numbers>("slot", numbered(1));
  EXPECT_THAT(ended(), ElementsAre("ok"));
}

TEST_F(ComponentsCalls, ReceiveInAModeThatDoesNotServeThePortIsNotActiveAndTheIdStaysValid) {
  std::optional<QueryId> id;
  const auto receive = [&id](Calling& of) -> Async<> {
    const auto answer = co_await of.questions.receive(*id, 1s);
    of.ended.push_back(std::string(to_string(answer.outcome())));
  };
  on_strand(bench, [&](Calling& calling) { id = *calling.questions.request(named("any"), 1h); });
  bench.start(kModeNeutral);
  on_strand(bench, [&](Calling& calling) { calling.spawn(receive(calling)); });
  bench.advance(1ms);
  EXPECT_THAT(ended(), ElementsAre("not_active"));
  bench.start();
  on_strand(bench, [&](Calling& calling) { calling.spawn(receive(calling)); });
  bench.advance(2s);
  EXPECT_THAT(ended(), ElementsAre("timeout"));
}

TEST_F(ComponentsCalls, ThatAreCancelledHaveNoReasonAndSoHasASend) {
  on_strand(bench, [](Calling& calling) {
    calling.cancel_calls();
    calling.spawn(calling.ask(1s));
    calling.spawn(calling.wait(1s));
    EXPECT_EQ(calling.orders.send(numbered(1)), Outcome::Cancelled);
  });
  bench.advance(1ms);
  EXPECT_THAT(ended(), ElementsAre("cancelled", "cancelled"));
  EXPECT_THAT(bench.take<Orders>("orders"), IsEmpty());
}

TEST_F(ComponentsCalls, WaitForTheNextOfAPortThatHandsOnlyTheNewestToItsHandler) {
  on_strand(bench, [](Calling& calling) { calling.spawn(calling.wait_newest(1s)); });
  bench.put<Numbers>("handled", numbered(7));
  EXPECT_THAT(ended(), ElementsAre("ok7"));
}

TEST_F(ComponentsCalls, BegunAfterARewireAreNotEndedByIt) {
  on_strand(bench, [](Calling& calling) {
    calling.spawn([](Calling& of) -> Async<> {
      of.ended.push_back("before " + std::string(to_string((co_await of.failing.query(named("a"), 1s)).outcome())));
    }(calling));
    calling.failing.end_for("bench")->set_connection(Connection::Connected, "on the bench again");
    calling.spawn([](Calling& of) -> Async<> {
      of.ended.push_back("after " + std::string(to_string((co_await of.failing.query(named("b"), 1s)).outcome())));
    }(calling));
  });
  bench.advance(1ms);
  EXPECT_THAT(ended(), ElementsAre("before disconnected"));
  bench.advance(2s);
  EXPECT_THAT(ended(), ElementsAre("after timeout"));
}

TEST_F(ComponentsCalls, BegunOnceAProviderIsBackAreNotEndedByItsLoss) {
  on_strand(bench, [](Calling& calling) {
    calling.slot.end_for("bench")->set_connection(Connection::Lost, "gone");
    calling.slot.end_for("bench")->set_connection(Connection::Connected, "back");
    calling.spawn(calling.wait(1s));
  });
  bench.put<Numbers>("slot", numbered(1));
  EXPECT_THAT(ended(), ElementsAre("ok"));
}

TEST_F(ComponentsCalls, LatestSaysWhyThereIsNothingThoughCallsAreCancelled) {
  on_strand(bench, [](Calling& calling) {
    calling.cancel_calls();
    EXPECT_EQ(calling.slot.latest().outcome(), Outcome::NoData);
    calling.slot.end_for("bench")->set_connection(Connection::Lost, "gone");
    EXPECT_EQ(calling.slot.latest().outcome(), Outcome::Disconnected);
  });
  bench.start(kModeDeactivated);
  on_strand(bench, [](Calling& calling) { EXPECT_EQ(calling.slot.latest().outcome(), Outcome::NotActive); });
}

TEST_F(ComponentsCalls, OfAPutThatWaitsTakeAnObjectByValueWithItsOrigin) {
  on_strand(bench, [](Calling& calling) { calling.spawn(calling.put_paced(TimePoint(5ms))); });
  const auto put = bench.take<Numbers>("numbers");
  ASSERT_THAT(put, SizeIs(1));
  EXPECT_EQ(put[0].origin, TimePoint(5ms));
}

TEST(SaturatingSum, EndsWithTheEndOfTime) {
  EXPECT_EQ(saturating_sum(TimePoint(5s), Duration::max()), TimePoint::max());
  EXPECT_EQ(saturating_sum(TimePoint(5s), Duration::max() - 5s), TimePoint::max());
  EXPECT_EQ(saturating_sum(TimePoint(5s), 1s), TimePoint(6s));
  EXPECT_EQ(saturating_sum(TimePoint(5s), Duration::min()), TimePoint(5s) + Duration::min());
  EXPECT_EQ(from_milliseconds(1.5), 1500us);
  EXPECT_EQ(from_milliseconds(1e300), Duration::max());
  EXPECT_EQ(from_milliseconds(-1e300), Duration::min());
  EXPECT_EQ(from_milliseconds(std::numeric_limits<double>::quiet_NaN()), 0s);
}

// ---- a failed instance ----------------------------------------------------------------------------------------

/// Goes on when its wait has ended, whatever has become of it meanwhile.
class Undeterred final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) spawn(go_on());
  }
  int rang = 0;
  std::vector<Outcome> outcomes;
  Requires<Numbers> slot{*this, "slot"};
  Requires<Orders> orders{*this, "orders"};
  Requires<Questions> questions{*this, "questions"};
  Provides<Numbers> numbers{*this, "numbers"};
  Provides<Alarms> alarms{*this, "alarms", &Undeterred::test};
  Timer timer{*this, &Undeterred::ring};

 private:
  Async<> go_on() {
    static_cast<void>(co_await slot.wait_update(1h));
    outcomes.push_back(numbers.put(numbered(1)));
    outcomes.push_back(orders.send(numbered(1)));
    outcomes.push_back(questions.request(named("any")).outcome());
    alarms.put(numbered(1));
    timer.at(now() + 1ms);
  }
  std::optional<Ruled> test(Ruled& limit, const Number&) {
    if (limit.name() == "int") throw 3;
    ++tested;
    return std::nullopt;
  }
  void ring() { ++rang; }

 public:
  int tested = 0;
};

TEST(FailedInstance, TakesPartInNothingThoughItsCoroutinesEnd) {
  testing::Bench<Undeterred> bench;
  bench.start();
  ASSERT_TRUE(bench.ask_any("alarms", std::make_shared<Ruled>(named("any"))).ok());
  bench.hull().fail("it broke");
  bench.advance(10ms);
  EXPECT_THAT(bench.component().outcomes, ElementsAre(Outcome::NotActive, Outcome::NotActive, Outcome::NotActive));
  EXPECT_EQ(bench.component().tested, 0);
  EXPECT_EQ(bench.component().rang, 0);
  EXPECT_THAT(bench.take<Numbers>("numbers"), IsEmpty());
}

TEST(EventTest, ThatThrowsNoStdExceptionEndsItsActivationAlone) {
  testing::Bench<Undeterred> bench;
  bench.start();
  ASSERT_TRUE(bench.ask_any("alarms", std::make_shared<Ruled>(named("int"))).ok());
  ASSERT_TRUE(bench.ask_any("alarms", std::make_shared<Ruled>(named("any"))).ok());
  on_strand(bench, [](Undeterred& provider) { provider.alarms.put(numbered(1)); });
  EXPECT_EQ(bench.mode(), kModeActive);
  EXPECT_EQ(bench.component().tested, 1);
  EXPECT_THAT(bench.log(), ElementsAre("component.alarms: the test of the activation failed: threw something that is "
                                       "not a std::exception"));
  on_strand(bench, [](Undeterred& provider) { EXPECT_EQ(provider.alarms.activations(), 1U); });
}

// ---- events and modes -----------------------------------------------------------------------------------------

/// Waits for a ring within a task, which holds its mode, or hears it with a handler.
class Watchful final : public Component {
 public:
  using Component::Component;
  using Component::spawn;
  std::vector<std::string> rings;
  EventMode mode = EventMode::Single;
  Requires<Alarms> waited{*this, "waited"};
  Requires<Alarms> heard{*this, "heard", &Watchful::on_ring};
  Async<> activate_heard() { static_cast<void>(co_await heard.activate(mode, named("any"))); }
  Async<> activate_waited() { kept = *(co_await waited.activate(mode, named("any"))); }
  Async<> wait_for_ring() {
    const auto ring = co_await waited.wait(kept, 60s);
    rings.push_back(std::string(to_string(ring.outcome())) + (ring ? (*ring)->name() : ""));
  }
  ActivationId kept{};

 private:
  void on_ring(const Fired<Ruled>& ring) { rings.push_back("heard " + ring->name()); }
  Async<> work() {
    if (waits_) co_return;
    waits_ = true;
    co_await activate_waited();
    co_await wait_for_ring();
  }
  bool waits_ = false;
  Task task_{*this, "work", 10ms, &Watchful::work};
};

TEST(EventTest, ThatAModesEndWaitsForReachesWhoHoldsTheMode) {
  testing::Bench<Watchful> bench;
  bench.start();
  bench.advance(20ms);
  bool made = false;
  bench.hull().change_mode(kModeNeutral, 10s, [&](const std::optional<Error>& error) { made = !error; });
  bench.advance(1ms);
  EXPECT_FALSE(made) << "its task holds the mode";
  EXPECT_EQ(bench.fire<Alarms>("waited", named("ring")), 1U);
  bench.advance(1ms);
  EXPECT_THAT(bench.component().rings, ElementsAre("okring"));
  EXPECT_TRUE(made);
}

TEST(CancelCalls, OfTheInstanceAndOfAPatternAreFlagsOfTheirOwn) {
  testing::Bench<Watchful> bench;
  bench.start();
  Hull& hull = bench.hull();
  on_strand(bench, [&hull](Watchful&) {
    const auto cancelled = [&hull] {
      return std::pair(hull.calls_are_cancelled(QUERY), hull.calls_are_cancelled(EVENT));
    };
    hull.cancel_calls(true, QUERY);
    EXPECT_EQ(cancelled(), std::pair(true, false));
    EXPECT_FALSE(hull.all_calls_are_cancelled());
    hull.cancel_calls(true);
    EXPECT_EQ(cancelled(), std::pair(true, true));
    hull.cancel_calls(false);
    EXPECT_EQ(cancelled(), std::pair(true, false));
    hull.cancel_calls(true);
    hull.cancel_calls(false, QUERY);
    EXPECT_EQ(cancelled(), std::pair(true, true));
    EXPECT_TRUE(hull.all_calls_are_cancelled());
    hull.cancel_calls(false);
    EXPECT_EQ(cancelled(), std::pair(false, false));
  });
}

TEST(EventTest, OfASingleActivationThatFindsItsClientInNoModeFiresWithALaterOne) {
  testing::Bench<Watchful> bench;
  bench.start();
  on_strand(bench, [](Watchful& client) { client.spawn(client.activate_heard()); });
  bench.start(kModeNeutral);
  EXPECT_EQ(bench.fire<Alarms>("heard", named("one")), 1U);
  EXPECT_THAT(bench.take_any("heard"), SizeIs(1));
  bench.advance(5s);
  EXPECT_THAT(bench.take_any("heard"), IsEmpty()) << "it would find the client in no mode again";
  bench.start();
  bench.advance(1s);
  EXPECT_THAT(bench.take_any("heard"), SizeIs(1)) << "its provider takes it for over, and is asked once more";
  EXPECT_EQ(bench.fire<Alarms>("heard", named("two")), 1U);
  EXPECT_THAT(bench.component().rings, ElementsAre("heard two"));
  EXPECT_EQ(bench.fire<Alarms>("heard", named("none")), 0U);
}

/// A provider of events at the end of a wire, whose mode does not serve its port yet.
struct LateProvider final : Sink {
  Outcome deliver(Parcel parcel) override {
    ++(is_active ? taken : refused);
    if (!is_active) parcel.reply->answer(Outcome::NotActive, "mode neutral", nullptr);
    return is_active ? parcel.reply->event({}) : Outcome::Ok;
  }
  bool is_active = false;
  int taken = 0;
  int refused = 0;
};

TEST(EventTest, OfAnActivationThatMovedToAProviderThatIsNotActiveIsMadeWithin500msOnceThatIs) {
  testing::Bench<Watchful> bench;
  bench.component().mode = EventMode::Continuous;
  bench.start();
  const auto provider = std::make_shared<LateProvider>();
  on_strand(bench, [](Watchful& client) { client.spawn(client.activate_heard()); });
  on_strand(bench, [&](Watchful& client) {
    const auto end = client.heard.end_for("bench");
    end->set_target(provider);
    end->set_connection(Connection::Connected, "on the bench again");
  });
  bench.advance(0ms);
  ASSERT_EQ(provider->refused, 1);
  provider->is_active = true;
  bench.advance(499ms);
  EXPECT_EQ(provider->taken, 0);
  bench.advance(1ms);
  EXPECT_EQ(provider->taken, 1);
}

TEST(EventTest, ThatNobodyWaitsForIsKeptByWhatItTakesOfMemory) {
  testing::Bench<Watchful> bench;
  bench.component().mode = EventMode::Continuous;
  bench.start();
  bench.advance(20ms);
  bench.component().mode = EventMode::Single;
  on_strand(bench, [](Watchful& client) { client.spawn(client.activate_waited()); });
  constexpr std::uint64_t kMore = 1000;
  constexpr std::uint64_t kFit = detail::EventClient::kMaxBytes / Inbox::cost_of(0);
  for (std::uint64_t i = 0; i < kFit + kMore; ++i) bench.fire<Alarms>("waited", Ruled());
  EXPECT_NEAR(static_cast<double>(bench.hull().find_port("waited")->counters().dropped), kMore, 2);
  on_strand(bench, [](Watchful& client) { client.spawn(client.wait_for_ring()); });
  bench.advance(1ms);
  EXPECT_THAT(bench.component().rings, Contains("ok")) << "the single one's is among those that are kept";
}

TEST(EventTest, ThatIsKeptIsOfItsMode) {
  testing::Bench<Watchful> bench;
  bench.component().mode = EventMode::Continuous;
  bench.start();
  bench.advance(20ms);
  bench.fire<Alarms>("waited", named("one"));  // by its task, which waits
  bench.advance(1ms);
  EXPECT_THAT(bench.component().rings, ElementsAre("okone"));
  bench.fire<Alarms>("waited", named("old"));
  bench.start(kModeNeutral);
  on_strand(bench, [](Watchful& client) { client.spawn(client.wait_for_ring()); });
  bench.advance(1ms);
  EXPECT_THAT(bench.component().rings, ElementsAre("okone", "not_active"));
  EXPECT_EQ(bench.hull().find_port("waited")->counters().not_active, 1U);
  bench.start();
  on_strand(bench, [](Watchful& client) { client.spawn(client.wait_for_ring()); });
  bench.advance(1ms);
  bench.fire<Alarms>("waited", named("new"));
  bench.advance(1ms);
  EXPECT_THAT(bench.component().rings, ElementsAre("okone", "not_active", "oknew"));
}

TEST(EventTest, ThatIsKeptOfASingleActivationIsAskedForAgainInTheNextMode) {
  testing::Bench<Watchful> bench;
  bench.start();
  bench.advance(20ms);
  bench.fire<Alarms>("waited", named("one"));
  bench.advance(1ms);
  on_strand(bench, [](Watchful& client) { client.spawn(client.activate_waited()); });
  bench.advance(1ms);
  EXPECT_EQ(bench.fire<Alarms>("waited", named("old")), 1U);
  bench.start(kModeNeutral);
  bench.start();
  bench.take_any("waited");
  bench.advance(1s);
  EXPECT_THAT(bench.take_any("waited"), SizeIs(1)) << "its provider takes it for over, and is asked once more";
  on_strand(bench, [](Watchful& client) { client.spawn(client.wait_for_ring()); });
  EXPECT_EQ(bench.fire<Alarms>("waited", named("new")), 1U);
  bench.advance(1ms);
  EXPECT_THAT(bench.component().rings, ElementsAre("okone", "oknew"));
}

/// What waits in it gives it up when its mode is left.
class GivesUp final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) spawn(wait());
  }
  Requires<Numbers> slot{*this, "slot"};

 private:
  Async<> wait() {
    static_cast<void>(co_await slot.wait_update(1h));
    hull().fail("it broke on its way out");
  }
};

TEST(FailedInstance, StaysSoThoughItWasAboutToEnterAnotherMode) {
  testing::Bench<GivesUp> bench;
  bench.start();
  EXPECT_THROW(bench.start(kModeNeutral), Error);
  EXPECT_EQ(bench.mode(), kModeFailed);
  EXPECT_EQ(bench.reason(), "it broke on its way out");
}

TEST(Stop, ThatThrowsIsToldToTheLog) {
  class Stops final : public Component {
   public:
    using Component::Component;
    void on_stop() override { throw std::runtime_error("the device is gone"); }
  };
  testing::Bench<Stops> bench;
  bench.start();
  EXPECT_EQ(bench.hull().shut_down(kLimit), std::nullopt);
  EXPECT_THAT(bench.log(), Contains("its stop failed: the device is gone"));
}

TEST(LoadLine, ParametersAreInPlaceAtTheStartAndNoChange) {
  class Tuned final : public Component {
   public:
    using Component::Component;
    void on_start() override { at_start = params->gain(); }
    void changed() { ++changes; }
    double at_start = 0;
    int changes = 0;
    Params<Settings> params{*this, nullptr, &Tuned::changed};
  };
  testing::Bench<Tuned> bench;
  bench.set("gain", 0.75);
  bench.start();
  EXPECT_EQ(bench.component().at_start, 0.75);
  EXPECT_EQ(bench.component().changes, 0);
  bench.set("gain", 0.25);
  EXPECT_EQ(bench.component().changes, 1);
}

TEST(LateParameters, AreTakenBack) {
  class Slow final : public Component {
   public:
    using Component::Component;
    void changed() {
      seen.push_back(params->gain());
      if (params->gain() == 0.25) goes_on.get_future().wait_for(kLimit);
    }
    std::promise<void> goes_on;
    std::vector<double> seen;
    Params<Settings> params{*this, nullptr, &Slow::changed};
  };
  SystemClock clock;
  Pool pool(1);
  KeptEvents events;
  Made<Slow> slow("slow", pool, clock, events);
  slow.hull.set_mode(kModeActive, kLimit);
  std::vector<control::Argument> gain(1);
  gain[0].set_name("gain");
  gain[0].mutable_value()->set_number(0.75);
  slow.hull.set_parameters(gain, kLimit);
  gain[0].mutable_value()->set_number(0.25);
  EXPECT_THROW(slow.hull.set_parameters(gain, 20ms), Error);
  slow->goes_on.set_value();
  slow.hull.strand().call([] {}, kLimit);
  EXPECT_THAT(slow->seen, ElementsAre(0.75, 0.25, 0.75));
  EXPECT_EQ(slow->params->gain(), 0.75) << "whoever was told that it failed finds nothing changed";
  clock.stop();
}

// ---- timers ---------------------------------------------------------------------------------------------------

class Timed final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeNeutral) timer.at(now() + 10ms);
  }
  void make() { passing.emplace(*this, &Timed::end_itself); }
  int rang = 0;
  Timer timer{*this, &Timed::ring};
  std::optional<Timer> passing;

 private:
  void ring() { ++rang; }
  void end_itself() {
    ++rang;
    passing.reset();
  }
};

TEST(Timers, DoNothingOutsideOfAMainMode) {
  testing::Bench<Timed> bench;
  bench.start(kModeNeutral);
  bench.advance(20ms);
  EXPECT_EQ(bench.component().rang, 0);
}

TEST(Timers, ThatWereSetInNeutralWorkInTheMainModeInWhichTheyComeDue) {
  testing::Bench<Timed> bench;
  bench.start(kModeNeutral);
  bench.start();
  bench.advance(20ms);
  EXPECT_EQ(bench.component().rang, 1);
}

TEST(Timers, ThatWereSetInAMainModeAreCancelledWhenItIsLeftThoughItIsEnteredAgainBeforeTheyAreDue) {
  for (const std::string_view mode : {kModeNeutral, kModeDeactivated}) {
    testing::Bench<Timed> bench;
    bench.start();
    on_strand(bench, [](Timed& timed) {
      timed.make();
      timed.passing->at(timed.now() + 5ms);
    });
    bench.start(mode);
    bench.start();
    bench.advance(8ms);
    EXPECT_EQ(bench.component().rang, 0) << mode;
  }
}

TEST(Timers, MayEndBeforeTheirComponent) {
  testing::Bench<Timed> bench;
  bench.start();
  on_strand(bench, [&](Timed& timed) {
    timed.make();
    timed.passing->at(timed.now() + 1ms);
    timed.passing.reset();
    timed.make();
    timed.passing->at(timed.now() + 2ms);
  });
  bench.advance(5ms);
  EXPECT_EQ(bench.component().rang, 1) << "the second, which ended itself";
  bench.start(kModeNeutral);
}

TEST(Timers, ThatHaveEndedWhenTheirTurnComesDoNothing) {
  testing::Bench<Timed> bench;
  bench.start();
  on_strand(bench, [&](Timed& timed) {
    timed.make();
    timed.passing->at(timed.now() + 1ms);
    timed.timer.at(timed.now() + 1ms);
  });
  on_strand(bench, [&](Timed& timed) { bench.hull().strand().post([&timed] { timed.passing.reset(); }); });
  bench.advance(5ms);
  EXPECT_EQ(bench.component().rang, 1);
}

// ---- coroutines of its own ------------------------------------------------------------------------------------

TEST(Spawn, NeedsNothingToBeDoneAtTheEnd) {
  testing::Bench<Calling> bench;
  bench.start();
  on_strand(bench, [&](Calling& calling) {
    calling.spawn(calling.wait(1ms));
    bench.hull().spawn(calling.wait(2ms), {});
  });
  bench.advance(5ms);
  EXPECT_THAT(bench.component().ended, ElementsAre("timeout", "timeout"));
  EXPECT_EQ(bench.mode(), kModeActive);
}

// ---- names ----------------------------------------------------------------------------------------------------

template <class C>
std::string refusal_of_names() {
  try {
    testing::Bench<C> bench;
  } catch (const Error& error) {
    return error.text().what;
  }
  return "";
}

class CountingTrigger : public Component {
 public:
  using Component::Component;
  Number run(const Number&) {
    ++runs;
    return {};
  }
  int runs = 0;
  Trigger<Number, Number> trigger{*this, "count", &CountingTrigger::run};
};

class NoReply final : public ReplySink {
 public:
  void answer(Outcome, std::string, std::shared_ptr<const Object>) override {}
};

TEST(CountingTriggers, AreNotRunForWhoHasGivenUpBeforeTheirTurn) {
  testing::Bench<CountingTrigger> bench;
  bench.start();
  const auto given_up = std::make_shared<NoReply>(), waits = std::make_shared<NoReply>();
  on_strand(bench, [&](CountingTrigger& one) {
    one.trigger.call(std::make_shared<Number>(), given_up);
    one.trigger.call(std::make_shared<Number>(), waits);
    given_up->abandon();
  });
  on_strand(bench, [&](CountingTrigger& one) { EXPECT_EQ(one.runs, 1); });
}

/// Calls a trigger once more as soon as it has been answered.
class CallsAgain final : public ReplySink {
 public:
  CallsAgain(detail::TriggerBase& trigger, std::shared_ptr<ReplySink> next)
      : trigger_(trigger), next_(std::move(next)) {}
  void answer(Outcome, std::string, std::shared_ptr<const Object>) override {
    trigger_.call(std::make_shared<Number>(), next_);
  }

 private:
  detail::TriggerBase& trigger_;
  const std::shared_ptr<ReplySink> next_;
};

TEST(CountingTriggers, HaveRoomForWhoHasItsAnswer) {
  testing::Bench<CountingTrigger> bench;
  bench.start();
  const auto next = std::make_shared<Heard>();
  on_strand(bench, [&](CountingTrigger& one) {
    one.trigger.call(std::make_shared<Number>(), std::make_shared<CallsAgain>(one.trigger, next));
    for (int i = 1; i < detail::TriggerBase::kMaxCalls; ++i)
      one.trigger.call(std::make_shared<Number>(), std::make_shared<NoReply>());
  });
  on_strand(bench, [](CountingTrigger&) {});
  on_strand(bench, [&](CountingTrigger& one) { EXPECT_EQ(one.runs, detail::TriggerBase::kMaxCalls + 1); });
  EXPECT_EQ(next->text, "ok: ");
}

struct SpacedPort final : Component {
  using Component::Component;
  Provides<Numbers> numbers{*this, "a b"};
};
struct DottedPort final : Component {
  using Component::Component;
  Provides<Numbers> numbers{*this, "a.b"};
};
struct SpacedTrigger final : Component {
  using Component::Component;
  Number run(const Number& number) { return number; }
  Trigger<Number, Number> trigger{*this, "a b", &SpacedTrigger::run};
};
struct SpacedTask final : Component {
  using Component::Component;
  void run() {}
  Task task{*this, "a b", 1s, &SpacedTask::run};
};
struct TwoTasks final : Component {
  using Component::Component;
  void run() {}
  Task one{*this, "twice", 1s, &TwoTasks::run};
  Task two{*this, "twice", 1s, &TwoTasks::run};
};
struct SpacedMode final : Component {
  using Component::Component;
  Modes modes{*this, {{"one", {}}, {"two two", {}}}};
};
struct TwoModes final : Component {
  using Component::Component;
  Modes one{*this, {{"one", {}}}};
  Modes two{*this, {{"two", {}}}};
};

TEST(Names, ThatCannotBeTypedAreRefusedWhereTheComponentIsMade) {
  EXPECT_EQ(refusal_of_names<SpacedPort>(), "'a b' is no name for a port");
  EXPECT_EQ(refusal_of_names<DottedPort>(), "'a.b' is no name for a port");
  EXPECT_EQ(refusal_of_names<SpacedTrigger>(), "'a b' is no name for a trigger");
  EXPECT_EQ(refusal_of_names<SpacedTask>(), "'a b' is no name for a task");
  EXPECT_EQ(refusal_of_names<SpacedMode>(), "'two two' is no name for a mode");
}

struct NewestEvents final : Component {
  using Component::Component;
  Requires<Alarms> alarms{*this, "alarms", {.delivery = Delivery::Newest}};
};

TEST(Ports, OfEventsThatAskForTheNewestOnlyAreRefusedWhereTheComponentIsMade) {
  EXPECT_EQ(refusal_of_names<NewestEvents>(), "port 'alarms' asks for the newest event only");
}

TEST(Names, OfTwoTasksAndTwoListsOfModesAreRefusedToo) {
  EXPECT_EQ(refusal_of_names<TwoTasks>(), "two tasks are named 'twice'");
  EXPECT_EQ(refusal_of_names<TwoModes>(), "a component has one list of main modes");
}

// ---- the bench ------------------------------------------------------------------------------------------------

TEST(BenchAsAWire, RefusesWhatBreaksARule) {
  testing::Bench<Answering> answering;
  answering.start();
  EXPECT_EQ(answering.ask<Questions>("at_once", named("ok", 11)).reason(),
            "the request was refused: length is 11, above 10 m");

  class Bad final : public Component {
   public:
    using Component::Component;
    Ruled answer(const Ruled& question) { return named(question.name(), 12); }
    void on_object(const Ruled&) { ++heard; }
    int heard = 0;
    Provides<Questions> questions{*this, "questions", &Bad::answer};
    Requires<RuledObjects> objects{*this, "objects", &Bad::on_object};
    Requires<Alarms> alarms{*this, "alarms"};
  };
  testing::Bench<Bad> bad;
  bad.start();
  EXPECT_EQ(bad.ask<Questions>("questions", named("ok")).reason(), "the answer was refused: length is 12, above 10 m");
  EXPECT_EQ(bad.put<RuledObjects>("objects", named("ok", 13)), Outcome::Rejected);
  EXPECT_EQ(bad.component().heard, 0);
  EXPECT_EQ(bad.component().objects.counters().refused, 1U);
  EXPECT_THAT([&] { bad.fire<Alarms>("alarms", named("ok", 14)); },
              ThrowsMessage<Error>(HasSubstr("the event was refused: length is 14, above 10 m")));
}

TEST(BenchAsAWire, TellsWhoAnswersTooLateThatNobodyWaits) {
  class Slow final : public Component {
   public:
    using Component::Component;
    void keep(const Ruled&, Reply<Ruled> reply) { kept.emplace(std::move(reply)); }
    std::optional<Reply<Ruled>> kept;
    Provides<Questions> questions{*this, "questions", &Slow::keep};
  };
  testing::Bench<Slow> bench;
  bench.start();
  EXPECT_EQ(bench.ask<Questions>("questions", named("ok"), 10ms).outcome(), Outcome::Timeout);
  EXPECT_TRUE(bench.component().kept->abandoned());
}

}  // namespace
}  // namespace fiona::sdk_test
