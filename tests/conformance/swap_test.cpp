// `swap … watch`: what both say is compared while both run; then all who used the one use the other, or nobody does.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include "../pulse.hpp"
#include "served_host.hpp"

namespace fiona::conformance {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;
using Steady = std::chrono::steady_clock;

class SwapThatIsWatched : public testing::TestWithParam<Transport> {
 protected:
  /// Two beacons five metres apart, one of them where the client is not; the client uses a.
  void load_two(const std::string& of_b = "") {
    console.load("beacon", "main", "a", "period_ms=2 heading=350");
    console.load("beacon", host.place(), "b", "period_ms=2 x=3 y=4 heading=10 " + of_b);
    console.load("navigator", host.place(), "nav");
    console.change(TestConsole::wire_of("nav.fixes", "a.fixes"));
  }
  Error refusal_of_swap(double watch_ms) {
    try {
      console.change(TestConsole::swap_of("a", "b", watch_ms));
    } catch (const Error& error) {
      return error;
    }
    throw std::runtime_error("it was swapped");
  }

  ServedHost host{GetParam()};
  TestConsole console{host};
};

TEST_P(SwapThatIsWatched, TellsHowFarTheTwoDifferThenSwapsWithoutALossAndIsOneChangeToUndo) {
  load_two();
  const tests::Pulse pulse;
  const control::Done done = console.change(TestConsole::swap_of("a", "b", 1000));
  EXPECT_EQ(done.watched_s(), 1);
  ASSERT_EQ(done.agreements_size(), 1);
  const auto& agreement = done.agreements(0);
  EXPECT_EQ(agreement.old().instance() + "." + agreement.old().port(), "a.fixes");
  EXPECT_EQ(agreement.next().instance() + "." + agreement.next().port(), "b.fixes");
  EXPECT_GT(agreement.old_messages(), 5U);
  EXPECT_EQ(agreement.next_valid(), agreement.next_messages());
  ASSERT_EQ(agreement.differences_size(), 2);
  EXPECT_EQ(agreement.differences(0).field(), "distance");
  EXPECT_EQ(agreement.differences(0).unit(), "m");
  EXPECT_DOUBLE_EQ(agreement.differences(0).median(), 5);
  EXPECT_DOUBLE_EQ(agreement.differences(0).most(), 5);
  EXPECT_GT(agreement.differences(0).compared(), 5U);
  EXPECT_EQ(agreement.differences(1).field(), "heading");
  EXPECT_DOUBLE_EQ(agreement.differences(1).median(), 20) << "across north, the short way round";
  EXPECT_EQ(done.switched(), 1U);
  // Between processes what the old one says last is not waited for without end, and a busy machine may hold it up.
  if (GetParam() == Transport::Process || pulse.longest_ms() < 20) {
    EXPECT_EQ(done.lost(), 0U);
  }
  EXPECT_EQ(console.peer_of("nav.fixes"), "b");
  console.undo();
  EXPECT_EQ(console.peer_of("nav.fixes"), "a");
}

TEST_P(SwapThatIsWatched, TellsTheMostThatWasSeenThoughItWasBrief) {
  load_two();
  TestConsole other(host);
  console.begin(TestConsole::swap_of("a", "b", 2500));
  // Over and over: the host may come to the first before it has come to the swap.
  for (const auto begun = Steady::now(); Steady::now() - begun < 2s;) {
    other.set("b", "x=30 y=40");
    std::this_thread::sleep_for(40ms);
    other.set("b", "x=3 y=4");
    std::this_thread::sleep_for(200ms);
  }
  const control::Done done = console.receive().done();
  EXPECT_DOUBLE_EQ(done.agreements(0).differences(0).most(), 50);
  EXPECT_DOUBLE_EQ(done.agreements(0).differences(0).median(), 5);
}

TEST_P(SwapThatIsWatched, IsNotMadeWhenTheNewOneSaysNothing) {
  load_two("silent=true");
  const Error error = refusal_of_swap(1000);
  EXPECT_EQ(error.code(), ErrorCode::Failed);
  EXPECT_EQ(error.text().what, "b.fixes said nothing while it was compared: nothing was swapped");
  EXPECT_THAT(error.text().expected, HasSubstr("what a.fixes said"));
  EXPECT_EQ(error.text().next, "show b");
  EXPECT_EQ(console.peer_of("nav.fixes"), "a");
  EXPECT_EQ(console.last_entry().steps(0).what_case(), control::Change::kWire) << "only what the test made";
}

TEST_P(SwapThatIsWatched, IsComparedThoughBothAreWatchedAsOftenAsTheyMayBe) {
  load_two("silent=true");
  for (const std::string port : {"a.fixes", "b.fixes"}) {
    control::Request request = console.request();
    *request.mutable_watch()->mutable_port() = port_name(port);
    request.mutable_watch()->set_min_period_ms(60'000);
    for (std::size_t i = 0; i < 32; ++i) {
      request.set_id(request.id() + 1000);
      console.send(request);
    }
  }
  TestConsole other(host);
  EXPECT_THAT([&] { return other.change(TestConsole::swap_of("a", "b", 1000)); },
              testing::ThrowsMessage<Error>(HasSubstr("b.fixes said nothing while it was compared")));
  EXPECT_EQ(other.peer_of("nav.fixes"), "a");
}

TEST_P(SwapThatIsWatched, IsNotMadeWhenTheNewOneSaysThatItIsNotValid) {
  load_two("valid=false");
  EXPECT_THAT(refusal_of_swap(1000).text().what,
              HasSubstr("times that it is not valid while it was compared: nothing was swapped"));
  EXPECT_EQ(console.peer_of("nav.fixes"), "a");
}

TEST_P(SwapThatIsWatched, IsMadeWhenTheOldOneIsTheOneThatIsNotValid) {
  load_two();
  console.set("a", "valid=false");
  const control::Done done = console.change(TestConsole::swap_of("a", "b", 1000));
  EXPECT_EQ(done.agreements(0).differences_size(), 0) << "nothing that may be compared";
  EXPECT_GT(done.agreements(0).old_messages(), done.agreements(0).old_valid());
  EXPECT_EQ(console.peer_of("nav.fixes"), "b");
}

TEST_P(SwapThatIsWatched, EndsAtOnceAndIsNotMadeWhenTheNewOneFails) {
  load_two();
  TestConsole other(host);
  console.begin(TestConsole::swap_of("a", "b", 3'600'000));
  other.set("b", "fail_with=bang");
  try {
    console.receive();
    FAIL() << "it was swapped";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::ComponentFailed);
    EXPECT_EQ(error.text().what, "'b' ended while it was compared: nothing was swapped");
    EXPECT_THAT(error.text().found, HasSubstr("bang"));
  }
  EXPECT_EQ(console.peer_of("nav.fixes"), "a");
}

TEST_P(SwapThatIsWatched, HoldsUpNoOtherChange) {
  load_two();
  TestConsole other(host);
  console.begin(TestConsole::swap_of("a", "b", 3'600'000));
  other.set("a", "period_ms=3");
  other.change(TestConsole::load_of("source", "main"));
  EXPECT_FALSE(console.has_answer());
  other.set("b", "fail_with=bang");
  EXPECT_THROW(console.receive(), Error);
}

TEST_P(SwapThatIsWatched, IsPlannedAsTheSystemIsWhenItsTimeIsOver) {
  load_two();
  TestConsole other(host);
  console.begin(TestConsole::swap_of("a", "b", 2'000));
  control::Change unwire;
  *unwire.mutable_unwire()->mutable_client() = port_name("nav.fixes");
  other.change(unwire);
  try {
    console.receive();
    FAIL() << "it was swapped";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "nobody uses 'a'");
  }
}

TEST_P(SwapThatIsWatched, IsRefusedWhereNothingCanBeCompared) {
  console.load("answerer", "main", "a");
  console.load("answerer", "main", "b");
  console.load("asker", host.place());
  console.change(TestConsole::wire_of("asker.echo", "a.echo"));
  const Error error = refusal_of_swap(200);
  EXPECT_EQ(error.text().what, "nothing that 'a' is used for can be compared");
  EXPECT_EQ(error.text().expected, "a port that pushes, and a client of it");
  EXPECT_EQ(error.text().next, "swap a for b, without watch");
}

TEST_P(SwapThatIsWatched, IsPlannedWithoutWaiting) {
  load_two();
  auto request = console.request();
  request.mutable_transact()->set_dry_run(true);
  *request.mutable_transact()->add_changes() = TestConsole::swap_of("a", "b", 3'600'000);
  const auto reply = console.ask(request);
  ASSERT_EQ(reply.planned().steps_size(), 1);
  EXPECT_EQ(reply.planned().steps(0).wire().provider().instance(), "b");
}

TEST_P(SwapThatIsWatched, TakesATimeThatIsNeitherTooShortNorTooLong) {
  load_two();
  for (const double watch_ms : {1.0, -5.0, 1e9}) {
    EXPECT_EQ(refusal_of_swap(watch_ms).text().what, "the time to compare is out of range");
  }
}

FIONA_OVER_EVERY_TRANSPORT(SwapThatIsWatched);

TEST(SwapThatIsWatchedOfOneThatDied, IsMadeForThereIsNothingToCompareWith) {
  ServedHost host;
  TestConsole console(host);
  console.load("beacon", "red", "a");
  console.load("beacon", "main", "b");
  console.load("navigator", "main", "nav");
  console.change(TestConsole::wire_of("nav.fixes", "a.fixes"));
  ::kill(console.process_of("red"), SIGKILL);
  console.eventually("its death is noticed", [&] { return console.instance("a").mode() == "failed"; });
  const control::Done done = console.change(TestConsole::swap_of("a", "b", 1000));
  EXPECT_EQ(done.agreements(0).old_messages(), 0U);
  EXPECT_GT(done.agreements(0).next_messages(), 0U);
  EXPECT_EQ(console.peer_of("nav.fixes"), "b");
}

}  // namespace
}  // namespace fiona::conformance
