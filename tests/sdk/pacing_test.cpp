// A put that waits for room, within a process: on a virtual clock step by step, and on two threads.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <future>
#include <memory>
#include <thread>

#include "fiona/local_wire.hpp"
#include "fiona/pool.hpp"
#include "fiona/sdk_test/objects.fiona.hpp"
#include "fiona/testing/inline_executor.hpp"
#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using namespace std::chrono_literals;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::SizeIs;

constexpr std::size_t kPayload = 500'000;
/// What the inbox holds, with the one that is being handled.
constexpr std::size_t kFit = Inbox::kMaxBytes / kPayload;

Number number(std::uint64_t value, std::size_t payload = kPayload) {
  Number one;
  one.set_value(value);
  one.set_payload(std::string(payload, 'x'));
  return one;
}

class Pourer final : public Component {
 public:
  using Component::Component;
  std::vector<Outcome> outcomes;
  std::promise<void> done;

  Async<> pour(std::uint64_t from, std::uint64_t count, std::size_t payload, Duration within) {
    for (std::uint64_t i = from; i < from + count; ++i) {
      const Outcome outcome = co_await numbers.put(number(i, payload), within);
      outcomes.push_back(outcome);
      if (outcome != Outcome::Ok) break;
    }
    if (outcomes.size() >= announced) done.set_value();
  }
  std::size_t announced = 1000;
  Provides<Numbers> numbers{*this, "numbers"};
};

/// Takes `sip` of its clock for each number.
class Sipper final : public Component {
 public:
  using Component::Component;
  Duration sip = 1ms;
  std::vector<std::uint64_t> seen;

  Requires<Numbers> never{*this, "never"};

 private:
  Async<> on_number(const Number& number) {
    seen.push_back(number.value());
    if (sip > Duration::zero()) static_cast<void>(co_await never.wait_update(sip));
  }
  void on_newest(const Number& number) { seen.push_back(number.value()); }
  Requires<Numbers> each_{*this, "each", &Sipper::on_number};
  Requires<Numbers> newest_{*this, "newest", &Sipper::on_newest, {.delivery = Delivery::Newest}};
};

/// A wire from the pourer to one of the sipper's ports.
std::shared_ptr<LocalWire> connect(Made<Pourer>& pourer, Made<Sipper>& sipper, const std::string& port,
                                   std::uint32_t prescale = 1) {
  auto& client = dynamic_cast<RequiredPort&>(*sipper.hull.find_port(port));
  const auto end = client.end_for(pourer->numbers.full_name());
  end->set_connection(Connection::Connected, "for the test");
  const auto wire = std::make_shared<LocalWire>(client.full_name() + "<" + pourer->numbers.full_name(), end, prescale);
  pourer->numbers.attach(wire);
  return wire;
}

class Pacing : public ::testing::Test {
 protected:
  Pacing() {
    sipper->never.end_for("silent.port")->set_connection(Connection::Connected, "for the test");
    pourer.hull.set_mode(kModeActive, kLimit);
    sipper.hull.set_mode(kModeActive, kLimit);
  }
  void pour(std::uint64_t from, std::uint64_t count, Duration within = 10s, std::size_t payload = kPayload) {
    pourer.hull.strand().call([&] { pourer.hull.spawn(pourer->pour(from, count, payload, within), [] {}); }, kLimit);
  }
  void advance(Duration duration) {
    clock.stop_at(clock.now() + duration, [this] { clock.hold(); });
    clock.release();
    executor.help();
  }
  std::uint64_t dropped() { return sipper.hull.find_port("each")->counters().dropped; }

  VirtualClock clock;
  testing::InlineExecutor executor;
  KeptEvents events;
  Made<Pourer> pourer{"pourer", executor, clock, events};
  Made<Sipper> sipper{"sipper", executor, clock, events};
};

TEST_F(Pacing, PutThatWaitsGoesAtThePaceOfItsSubscriberAndLosesNothing) {
  connect(pourer, sipper, "each");
  pour(1, 60);
  advance(30ms);
  EXPECT_GE(pourer->outcomes.size(), 30U);
  EXPECT_LE(pourer->outcomes.size(), 31 + kFit) << "what the inbox holds ahead of the subscriber";
  advance(100ms);
  EXPECT_THAT(pourer->outcomes, SizeIs(60));
  EXPECT_THAT(sipper->seen, SizeIs(60));
  EXPECT_TRUE(std::is_sorted(sipper->seen.begin(), sipper->seen.end()));
  EXPECT_EQ(dropped(), 0U);
}

TEST_F(Pacing, PutWithoutRoomInTimeEndsWithTimeoutAndIsNotPut) {
  connect(pourer, sipper, "each");
  sipper->sip = 1h;
  pour(1, 60, 50ms);
  advance(49ms);
  EXPECT_THAT(pourer->outcomes, Each(Outcome::Ok));
  advance(2ms);
  EXPECT_EQ(pourer->outcomes.back(), Outcome::Timeout);
  EXPECT_EQ(pourer->numbers.counters().messages, pourer->outcomes.size() - 1);
  EXPECT_LE(pourer->outcomes.size() - 1, kFit + 1);
}

TEST_F(Pacing, PutThatWaitsGoesOnWhenItsSubscriberIsDetached) {
  const auto wire = connect(pourer, sipper, "each");
  sipper->sip = 1h;
  pour(1, 60);
  advance(5ms);
  EXPECT_LT(pourer->outcomes.size(), 60U);
  wire->cut("the test ends");
  pourer->numbers.detach(*wire);
  advance(5ms);
  EXPECT_THAT(pourer->outcomes, SizeIs(60));
}

TEST_F(Pacing, PutThatWaitsDoesNotWaitForTheNewest) {
  connect(pourer, sipper, "newest");
  pour(1, 60);
  advance(1ms);
  EXPECT_THAT(pourer->outcomes, SizeIs(60));
}

TEST_F(Pacing, PutWaitsOnlyForWhoTakesThatMessage) {
  connect(pourer, sipper, "each", 20);
  sipper->sip = 1h;
  pour(1, 60);
  advance(1ms);
  EXPECT_THAT(pourer->outcomes, SizeIs(60)) << "three of them are for the subscriber, and fit";
}

TEST_F(Pacing, PutsThatWaitHaveTheirTurnInTheirOrder) {
  connect(pourer, sipper, "each");
  sipper->sip = 10ms;
  pour(1, 20);
  advance(1ms);
  pour(100, 1, 10s, 1);  // would fit at once
  advance(1s);
  ASSERT_THAT(sipper->seen, SizeIs(21));
  EXPECT_GT(std::find(sipper->seen.begin(), sipper->seen.end(), 100) - sipper->seen.begin(),
            static_cast<std::ptrdiff_t>(kFit));
  EXPECT_EQ(dropped(), 0U);
}

TEST_F(Pacing, PutThatWaitsEndsWithItsModeOrByItsFlag) {
  connect(pourer, sipper, "each");
  sipper->sip = 1h;
  pour(1, 60);
  advance(1ms);
  pourer.hull.strand().call([&] { pourer->numbers.cancel_calls(); }, kLimit);
  advance(1ms);
  EXPECT_EQ(pourer->outcomes.back(), Outcome::Cancelled);
  pourer.hull.strand().call([&] { pourer->numbers.cancel_calls(false); }, kLimit);
  pour(1, 60);
  advance(1ms);
  pourer.hull.set_mode(kModeNeutral, kLimit);
  advance(1ms);
  EXPECT_EQ(pourer->outcomes.back(), Outcome::NotActive);
}

TEST_F(Pacing, AMessageLargerThanAllRoomIsPutWhenNothingElseIsThere) {
  connect(pourer, sipper, "each");
  pour(1, 3, 10s, 2 * Inbox::kMaxBytes);
  advance(1s);
  EXPECT_THAT(sipper->seen, ElementsAre(1, 2, 3));
  EXPECT_EQ(dropped(), 0U);
}

TEST_F(Pacing, PutThatWaitsGoesOnWhenWhatWaitedBeforeItIsOfAModeThatIsLeft) {
  connect(pourer, sipper, "each");
  sipper->sip = 1h;
  pour(1, 60);
  advance(5ms);
  EXPECT_LT(pourer->outcomes.size(), 60U);
  sipper.hull.fail("for the test");
  advance(5ms);
  EXPECT_THAT(pourer->outcomes, SizeIs(60));
  EXPECT_THAT(pourer->outcomes, Each(Outcome::Ok));
}

TEST_F(Pacing, WhoWishesForRoomIsToldThoughAnotherHasTakenItInBetween) {
  Inbox& inbox = *sipper.hull.find_port("each")->inbox();
  const auto fill = [&] {
    const auto large = std::make_shared<const Number>(number(1, Inbox::kMaxBytes));
    inbox.push(Parcel{Envelope{large, 1, {}, large->ByteSizeLong()}, nullptr});
  };
  fill();
  const auto who = std::make_shared<int>();
  const auto other = std::make_shared<int>();
  std::vector<std::size_t> told;
  const auto takes_it = [&](std::size_t room) {
    told.push_back(room);
    fill();
  };
  ASSERT_FALSE(inbox.room(1, who, takes_it));
  ASSERT_FALSE(inbox.room(1, other, [&](std::size_t room) { told.push_back(room); }));
  inbox.clear(Outcome::Disconnected);
  EXPECT_THAT(told, ElementsAre(Inbox::kMaxBytes, Inbox::kMaxBytes));
}

TEST_F(Pacing, WhoWishesForRoomAgainBeforeHeIsToldHasOneWish) {
  Inbox& inbox = *sipper.hull.find_port("each")->inbox();
  const auto large = std::make_shared<const Number>(number(1, Inbox::kMaxBytes));
  inbox.push(Parcel{Envelope{large, 1, {}, large->ByteSizeLong()}, nullptr});
  const auto who = std::make_shared<int>();
  std::vector<int> told;
  for (int i = 1; i <= 1000; ++i) {
    ASSERT_FALSE(inbox.room(1, who, [&told, i](std::size_t) { told.push_back(i); }));
  }
  inbox.clear(Outcome::Disconnected);
  EXPECT_THAT(told, ElementsAre(1000));
}

TEST(PacingOnThreads, NothingIsLostAndNobodyWaitsForEver) {
  SystemClock clock;
  Pool pool(3);
  KeptEvents events;
  {
    Made<Pourer> pourer("pourer", pool, clock, events);
    Made<Sipper> sipper("sipper", pool, clock, events);
    sipper->sip = 0ms;
    pourer->announced = 1000;
    pourer.hull.set_mode(kModeActive, kLimit);
    sipper.hull.set_mode(kModeActive, kLimit);
    connect(pourer, sipper, "each");
    pourer.hull.strand().call([&] { pourer.hull.spawn(pourer->pour(1, 1000, 50'000, kLimit), [] {}); }, kLimit);
    ASSERT_EQ(pourer->done.get_future().wait_for(kLimit), std::future_status::ready);
    const auto& counters = sipper.hull.find_port("each")->counters();
    const auto end = std::chrono::steady_clock::now() + kLimit;
    while (counters.messages < 1000 && std::chrono::steady_clock::now() < end) std::this_thread::yield();
    EXPECT_EQ(counters.messages, 1000U);
    EXPECT_EQ(counters.dropped, 0U);
  }
  clock.stop();
}

}  // namespace
}  // namespace fiona::sdk_test
