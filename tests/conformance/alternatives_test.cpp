// Ordered alternatives of a required port: who serves, when the next one takes over, and when the better one is back.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <map>
#include <sstream>
#include <utility>

#include "fiona/error.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;
using namespace std::chrono_literals;

/// What a navigator heard, as its probe says it: "a 1-57, b 12-40".
struct Spell {
  std::string source;
  std::uint64_t first = 0;
  std::uint64_t last = 0;
  bool valid = true;
};
std::vector<Spell> runs_of(const std::string& heard) {
  std::vector<Spell> runs;
  std::istringstream text(heard);
  for (std::string source, range; text >> source >> range;) {
    const std::size_t dash = range.find('-');
    runs.push_back({source, std::stoull(range), std::stoull(range.substr(dash + 1)), range[dash - 1] != '!'});
  }
  return runs;
}

std::string sources_of(const std::string& heard) {
  std::string text;
  for (const Spell& run : runs_of(heard)) text += (text.empty() ? "" : " ") + run.source;
  return text;
}

/// The same where a source may leave out what has become too old on a busy machine.
std::string order_of_sources(const std::string& heard) {
  std::string text, before;
  for (const Spell& run : runs_of(heard)) {
    if (run.source != std::exchange(before, run.source)) text += (text.empty() ? "" : " ") + run.source;
  }
  return text;
}

class Alternatives : public testing::TestWithParam<Transport> {
 protected:
  /// Two beacons, and a navigator whose `port` takes a's, else b's.
  void wire_two(const std::string& port, double hold_ms, const std::string& parameters = "period_ms=2") {
    system.load_provider("beacon", "a", parameters);
    system.load_provider("beacon", "b", parameters);
    system.load_client("navigator", "nav");
    wire_fixes(port, {"a", "b"}, hold_ms);
  }
  control::Done wire_fixes(const std::string& port, const std::vector<std::string>& beacons, double hold_ms) {
    std::vector<std::string> providers;
    for (const auto& name : beacons)
      providers.push_back(name + "." + (port == "latest" || port == "fresh" ? "fixes" : port));
    return system.wire_to_several("nav." + port, providers, hold_ms);
  }
  std::string heard() { return system.read("nav.heard").payload(); }
  std::string serving(const std::string& port = "fixes") { return system.read("nav." + port + ".serving").payload(); }
  void until_served_by(const std::string& name, const std::string& port = "fixes") {
    system.eventually("served by " + name, [&] { return serving(port) == name; });
  }
  /// Until the last that was heard is from this one.
  void until_heard(const std::string& source) {
    system.eventually("heard from " + source, [&] {
      const auto runs = runs_of(heard());
      return !runs.empty() && runs.back().source == source && runs.back().last > runs.back().first;
    });
  }
  void until_last_is(const std::string& source) {
    system.eventually("the last is from " + source, [&] {
      const auto runs = runs_of(heard());
      return !runs.empty() && runs.back().source == source;
    });
  }
  std::string reason(const std::string& port = "fixes") { return system.port("nav." + port).reason(); }

  RunningSystem system{GetParam()};
};

TEST_P(Alternatives, TheFirstThatIsThereServes) {
  wire_two("fixes", 50);
  until_heard("a");
  const auto port = system.port("nav.fixes");
  EXPECT_EQ(port.connection(), control::CONNECTED);
  EXPECT_EQ(port.peer().instance(), "a");
  ASSERT_EQ(port.providers_size(), 2);
  EXPECT_TRUE(port.providers(0).serves());
  EXPECT_TRUE(port.providers(1).fit()) << "connected all the time";
  EXPECT_FALSE(port.providers(1).serves());
  EXPECT_EQ(port.providers(1).transport(), GetParam() == Transport::Process ? "process"
                                           : to_string(GetParam()) == "Ipc" ? "ipc"
                                                                            : "tcp");
  EXPECT_EQ(system.port("b.fixes").clients_size(), 1);
}

TEST_P(Alternatives, TheNextOneServesWhenAnObjectSaysThatItIsNotValidWhichDoesNotArrive) {
  wire_two("fixes", 60'000);
  until_heard("a");
  system.set("a", "valid=false");
  until_heard("b");
  EXPECT_EQ(heard().find('!'), std::string::npos) << heard();
  EXPECT_EQ(sources_of(heard()), "a b") << heard();
  EXPECT_EQ(system.port("nav.fixes").connection(), control::CONNECTED);
  EXPECT_EQ(system.port("nav.fixes").providers(0).reason(), "a.fixes says that it is not valid");
}

TEST_P(Alternatives, TheNextOneServesWhenTheFirstSaysWhatIsTooOldForThePort) {
  wire_two("fresh", 50);
  until_heard("a");
  system.set("a", "late_ms=2000");
  until_heard("b");
  EXPECT_EQ(system.port("nav.fresh").connection(), control::CONNECTED);
  EXPECT_EQ(system.port("nav.fresh").providers(0).reason(), "a.fixes says what is older than the port takes");
  EXPECT_EQ(serving("fresh"), "b.fixes");
  system.set("a", "late_ms=0");
  until_heard("a");
  EXPECT_EQ(order_of_sources(heard()), "a b a") << heard();
}

TEST_P(Alternatives, TheNextOneServesWhenTheFirstIsSilentForLongerThanItsLease) {
  wire_two("fixes", 60'000);
  until_heard("a");
  system.set("a", "silent=true");
  until_heard("b");
  EXPECT_EQ(sources_of(heard()), "a b") << heard();
  EXPECT_EQ(system.port("nav.fixes").providers(0).reason(), "a.fixes has been silent for 1000 ms");
}

TEST_P(Alternatives, TheNextOneServesWhenTheFirstIsUnloadedAndItIsBackAfterItIsLoadedAgain) {
  wire_two("fixes", 50);
  until_heard("a");
  system.unload("a");
  until_heard("b");
  EXPECT_EQ(system.port("nav.fixes").providers(0).reason(), "a.fixes: there is no instance 'a' yet");
  system.load_provider("beacon", "a", "period_ms=2");
  until_heard("a");
  EXPECT_EQ(sources_of(heard()), "a b a") << heard();
}

TEST_P(Alternatives, TheNextOneServesWhenTheFirstsProcessIsKilled) {
  system.load_in("red", "beacon", "a", "period_ms=2");
  system.load_provider("beacon", "b", "period_ms=2");
  system.load_client("navigator", "nav");
  wire_fixes("fixes", {"a", "b"}, 50);
  until_heard("a");
  ::kill(system.group("red").process(), SIGKILL);
  until_heard("b");
  EXPECT_EQ(sources_of(heard()), "a b") << heard();
  EXPECT_THAT(system.port("nav.fixes").providers(0).reason(), HasSubstr("group 'red'"));
  system.unload("a");
  system.load_in("blue", "beacon", "a", "period_ms=2");
  until_heard("a");
}

TEST_P(Alternatives, TheBetterOneIsBackOnlyAfterTheHoldTime) {
  wire_two("fixes", 400);
  until_heard("a");
  system.set("a", "valid=false");
  until_heard("b");
  const auto since = std::chrono::steady_clock::now();
  system.set("a", "valid=true");
  until_served_by("a.fixes");
  EXPECT_GE(std::chrono::steady_clock::now() - since, 400ms);
  until_heard("a");
  EXPECT_EQ(sources_of(heard()), "a b a") << heard();
}

TEST_P(Alternatives, OneThatFailsAgainWithinTheHoldTimeIsCountedAsAFlapAndDoesNotServe) {
  wire_two("fixes", 60'000);
  until_heard("a");
  for (int flap = 1; flap <= 3; ++flap) {
    system.set("a", "valid=false");
    system.eventually("flap", [&] { return system.read("nav.fixes.flaps").value() == flap; });
    system.set("a", "valid=true");
    system.eventually("fit again", [&] { return system.port("nav.fixes").providers(0).fit(); });
  }
  EXPECT_EQ(serving(), "b.fixes");
  EXPECT_EQ(system.port("nav.fixes").flaps(), 3U);
  EXPECT_EQ(sources_of(heard()), "a b") << heard();
}

TEST_P(Alternatives, WhenNoneIsFitThePortIsLostWithEachReasonAndNeitherLatestNorAWaitPassesThatForSilence) {
  wire_two("latest", 50);
  system.eventually("a value", [&] { return system.read("nav.latest_is").payload() == "ok a"; });
  system.set("b", "silent=true");
  system.eventually("b is silent", [&] { return !system.port("nav.latest").providers(1).fit(); });
  system.set("a", "valid=false");
  system.eventually("lost", [&] { return system.port("nav.latest").connection() == control::LOST; });
  const std::string expected = "a.fixes says that it is not valid; b.fixes has been silent for 1000 ms";
  EXPECT_EQ(reason("latest"), expected);
  EXPECT_EQ(serving("latest"), "");
  system.eventually("disconnected", [&] { return system.read("nav.latest_is").payload() == "disconnected"; });
  system.eventually("the wait ends", [&] { return system.read("nav.wait_ended").payload() == expected; });
  system.set("b", "silent=false");
  system.eventually("b's value", [&] { return system.read("nav.latest_is").payload() == "ok b"; });
}

TEST_P(Alternatives, WhileNoneIsFitAHandlerHearsFromOneThatItIsNotValid) {
  wire_two("fixes", 50);
  until_heard("a");
  system.set("b", "valid=false");
  system.eventually("b is not valid", [&] { return !system.port("nav.fixes").providers(1).fit(); });
  system.set("a", "valid=false");
  system.eventually("it is told", [&] {
    const auto runs = runs_of(heard());
    return !runs.back().valid && runs.back().source == "a" && runs.back().last > runs.back().first;
  });
  EXPECT_EQ(system.port("nav.fixes").connection(), control::LOST);
  system.set("b", "valid=true");
  until_heard("b");
  EXPECT_EQ(sources_of(heard()), "a a b") << heard();
}

TEST_P(Alternatives, NothingComesFromTwoAtOnceAndNothingTwiceHoweverOftenTheyChange) {
  wire_two("fixes", 0, "period_ms=1");
  for (int turn = 0; turn < 10; ++turn) {
    system.set("a", "valid=false");
    until_last_is("b");
    system.set("a", "valid=true");
    until_last_is("a");
  }
  const auto runs = runs_of(heard());
  std::map<std::string, std::uint64_t> last;
  std::string before;
  for (const Spell& run : runs) {
    EXPECT_NE(run.source, before) << "a gap in what one says: " << heard();
    EXPECT_TRUE(run.valid);
    EXPECT_GT(run.first, last[run.source]) << heard();
    last[run.source] = run.last;
    before = run.source;
  }
  EXPECT_GE(runs.size(), 20U);
}

TEST_P(Alternatives, PrescaleLeavesTheOrderOfEachProvidersMessages) {
  system.load_provider("beacon", "a", "period_ms=1");
  system.load_provider("beacon", "b", "period_ms=1");
  system.load_client("navigator", "nav", "step=3");
  system.wire_to_several("nav.fixes", {"a.fixes", "b.fixes"}, 0, 3);
  until_heard("a");
  system.set("a", "valid=false");
  until_heard("b");
  system.set("a", "valid=true");
  until_heard("a");
  EXPECT_EQ(sources_of(heard()), "a b a") << heard();
}

TEST_P(Alternatives, WhatThePrescaleLeavesOutIsNotLookedAtForValidity) {
  system.load_provider("beacon", "a", "silent=true period_ms=1 valid_each=3");
  system.load_provider("beacon", "b", "period_ms=1");
  system.load_client("navigator", "nav", "step=3");
  system.wire_to_several("nav.fixes", {"a.fixes", "b.fixes"}, 0, 3);
  until_heard("b");
  system.set("a", "silent=false");
  until_heard("a");
  system.eventually("many of its", [&] { return runs_of(heard()).back().last > 300; });
  EXPECT_EQ(sources_of(heard()), "b a") << heard();
}

TEST_P(Alternatives, TheNewOnesLastValueComesWithTheChangeOfAServiceThatSpeaksOnChange) {
  system.load_provider("beacon", "a", "once=true");
  system.load_provider("beacon", "b", "once=true");
  system.load_client("navigator", "nav");
  wire_fixes("last", {"a", "b"}, 100);
  const auto told = [&] { return sources_of(system.read("nav.last_heard").payload()); };
  system.eventually("a's", [&] { return told() == "a"; });
  system.set("a", "silent=true");
  system.eventually("b's", [&] { return told() == "a b"; });
  system.set("a", "silent=false");
  system.eventually("a's again: it holds still", [&] { return told() == "a b a"; });
}

TEST_P(Alternatives, ANameThatNothingHasYetIsAWaitingAlternative) {
  system.load_provider("beacon", "b", "period_ms=2");
  system.load_client("navigator", "nav");
  const auto done = wire_fixes("fixes", {"a", "b"}, 50);
  ASSERT_EQ(done.warnings_size(), 1);
  EXPECT_THAT(done.warnings(0), StartsWith("nav.fixes waits: there is no instance 'a' yet"));
  until_heard("b");
  system.load_provider("beacon", "a", "period_ms=2");
  until_heard("a");
}

TEST_P(Alternatives, APortThatOnlyWaitsSaysForWhom) {
  system.load_client("navigator", "nav");
  wire_fixes("fixes", {"a", "b"}, 50);
  const auto port = system.port("nav.fixes");
  EXPECT_EQ(port.connection(), control::WAITING);
  for (const auto& provider : port.providers()) EXPECT_FALSE(provider.serves()) << provider.provider().instance();
  EXPECT_EQ(reason(), "a.fixes: there is no instance 'a' yet; b.fixes: there is no instance 'b' yet");
  system.load_provider("beacon", "b", "period_ms=2");
  until_heard("b");
}

TEST_P(Alternatives, WhoStaysAtARewireStaysConnectedAndLosesNothing) {
  wire_two("fixes", 50, "period_ms=1");
  until_heard("a");
  system.load_provider("beacon", "c", "period_ms=1");
  wire_fixes("fixes", {"a", "c", "b"}, 60'000);
  wire_fixes("fixes", {"a", "c"}, 60'000);
  system.wire("nav.fixes", "a.fixes");
  system.eventually("more", [&] { return runs_of(heard()).back().last > 200; });
  EXPECT_EQ(sources_of(heard()), "a") << heard();
  EXPECT_TRUE(system.port("nav.fixes").providers().empty());
  EXPECT_EQ(system.port("b.fixes").clients_size(), 0);
}

TEST_P(Alternatives, WhoIsLeftOutIsFollowedAtOnce) {
  wire_two("fixes", 60'000);
  until_heard("a");
  wire_fixes("fixes", {"b"}, -1);
  until_heard("b");
  EXPECT_EQ(sources_of(heard()), "a b") << heard();
  wire_fixes("fixes", {"a", "b"}, 0);
  until_heard("a");
}

TEST_P(Alternatives, UnwireTakesAllAway) {
  wire_two("fixes", 50);
  until_heard("a");
  system.unwire("nav.fixes");
  const auto port = system.port("nav.fixes");
  EXPECT_EQ(port.connection(), control::UNWIRED);
  EXPECT_TRUE(port.providers().empty());
  EXPECT_EQ(system.port("a.fixes").clients_size() + system.port("b.fixes").clients_size(), 0);
  system.wire("nav.fixes", "b.fixes");
  until_heard("b");
  EXPECT_EQ(sources_of(heard()), "a b") << heard();
}

TEST_P(Alternatives, AProviderNamedTwiceIsRefused) {
  wire_two("fixes", 50);
  try {
    wire_fixes("fixes", {"a", "b", "a"}, 50);
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "a.fixes is named twice");
    EXPECT_EQ(error.text().where, "nav.fixes");
  }
  EXPECT_EQ(system.port("nav.fixes").providers_size(), 2);
}

TEST_P(Alternatives, EachIsCheckedAgainstTheClientsContract) {
  wire_two("fixes", 50);
  try {
    system.wire_to_several("nav.fixes", {"a.fixes", "b.last"});
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_THAT(error.text().what, HasSubstr("nav.fixes requires Fixes"));
    EXPECT_THAT(error.text().what, HasSubstr("b.last provides LastFixes"));
  }
}

TEST_P(Alternatives, AHoldTimeIsForAlternatives) {
  wire_two("fixes", 50);
  EXPECT_THROW(system.wire_to_several("nav.fixes", {"a.fixes"}, 1000), Error);
  EXPECT_THROW(system.wire_to_several("nav.fixes", {"a.fixes", "b.fixes"}, 3'600'001), Error);
}

// ---- query, send, event ---------------------------------------------------------------------------------------

TEST_P(Alternatives, QueriesAndSendsGoToTheOneThatServesAndEndOnceEachThoughItIsKilled) {
  system.load_in("red", "beacon", "a");
  system.load_provider("beacon", "b");
  system.load_client("navigator", "nav", "asks_ms=2 manner=later");
  system.wire_to_several("nav.echo", {"a.echo", "b.echo"}, 200);
  system.wire_to_several("nav.orders", {"a.orders", "b.orders"}, 200);
  const auto answered_by = [&](const std::string& name) { return system.read("nav.answered_by").payload() == name; };
  system.eventually("answers of a", [&] { return answered_by("a"); });
  EXPECT_FALSE(system.read("b.ordered").has_value);
  ::kill(system.group("red").process(), SIGKILL);
  system.eventually("answers of b", [&] { return answered_by("b") && system.read("b.ordered").has_value; });
  system.unload("a");
  system.load_in("blue", "beacon", "a");
  system.eventually("answers of a again", [&] { return answered_by("a"); });
  system.set("nav", "asks_ms=0");
  const std::string answers = system.read("nav.answers").payload();
  EXPECT_THAT(answers, Not(HasSubstr("WRONG")));
  EXPECT_THAT(answers, Not(HasSubstr("timeout"))) << "what was open at a's end is told so at once";
}

TEST_P(Alternatives, ARequestThatIsOpenWhenTheBetterOneIsBackEndsWhereItWasPut) {
  system.load_provider("beacon", "b");
  system.load_client("navigator", "nav", "manner=later");
  system.wire_to_several("nav.echo", {"a.echo", "b.echo"}, 20);
  until_served_by("b.echo", "echo");
  system.set("nav", "asks_ms=2");
  const auto answered_by = [&](const std::string& name) { return system.read("nav.answered_by").payload() == name; };
  system.eventually("answers of b", [&] { return answered_by("b"); });
  system.load_provider("beacon", "a");
  system.eventually("answers of a", [&] { return answered_by("a"); });
  const std::string answers = system.read("nav.answers").payload();
  EXPECT_THAT(answers, StartsWith("a="));
  EXPECT_THAT(answers, Not(HasSubstr("disconnected"))) << answers;
  EXPECT_THAT(answers, Not(HasSubstr("WRONG"))) << answers;
}

TEST_P(Alternatives, AnActivationIsMadeAgainAtTheOneThatServes) {
  system.load_provider("source", "b", "period_ms=2");
  system.load_in("red", "source", "a", "period_ms=2");
  system.load_client("caller", "caller", "call=activate_handled");
  system.wire_to_several("caller.handled_bell", {"a.bell", "b.bell"}, 200);
  const auto rings = system.watch("caller.rings");
  system.set("caller", "go=1");
  system.wait_for(rings, [](const auto& ring) { return ring.number() >= 3; });
  ::kill(system.group("red").process(), SIGKILL);
  system.eventually("b serves", [&] { return system.read("caller.handled_bell.serving").payload() == "b.bell"; });
  system.take(rings);
  const auto next = system.wait_for(rings, [](const auto&) { return true; });
  system.wait_for(rings, [&](const auto& ring) { return ring.number() > next.number() + 3; });
}

FIONA_OVER_EVERY_TRANSPORT(Alternatives);

// ---- on a virtual clock ---------------------------------------------------------------------------------------

/// Where each of a, b and the navigator lives.
struct Places {
  std::string a, b, nav;
};

/// What a navigator heard while one beacon failed and came back at exact times.
std::string heard_on_a_virtual_clock(std::size_t threads, const Places& at,
                                     std::vector<std::string>* serving = nullptr) {
  RunningSystem system(threads, 5s);
  system.set("host", "clock=virtual");
  system.load_in(at.a, "beacon", "a", "period_ms=10");
  system.load_in(at.b, "beacon", "b", "period_ms=10");
  system.load_in(at.nav, "navigator", "nav");
  system.wire_to_several("nav.fixes", {"a.fixes", "b.fixes"});
  const auto let_pass = [&](std::chrono::milliseconds time) {
    const auto reply = system.let_pass(time);
    EXPECT_TRUE(reply.has_met()) << reply.ShortDebugString();
    if (serving) serving->push_back(system.read("nav.fixes.serving").payload());
  };
  let_pass(105ms);
  system.set("a", "valid=false");
  let_pass(10ms);  // at 110 ms a says that it is not valid
  system.set("a", "valid=true");
  let_pass(2000ms);  // valid again from 120 ms on
  system.set("a", "silent=true");
  let_pass(1000ms);  // silent from 3110 ms on: it spoke at 2110 ms, and 3 s would be over at 3120 ms
  system.set("a", "silent=false");
  let_pass(2999ms);  // speaks again from 3120 ms on: 3 s are over at 6120 ms
  let_pass(5ms);
  let_pass(5ms);
  return system.read("nav.heard").payload();
}

TEST(AlternativesVirtual, TheHoldTimeIsKeptToTheInstantOnTheInstancesClock) {
  std::vector<std::string> serving;
  const std::string heard = heard_on_a_virtual_clock(2, {"main", "main", "main"}, &serving);
  EXPECT_EQ(serving,
            (std::vector<std::string>{"a.fixes", "b.fixes", "b.fixes", "b.fixes", "b.fixes", "b.fixes", "a.fixes"}))
      << heard;
  EXPECT_EQ(sources_of(heard), "a b a") << heard;
}

TEST(AlternativesVirtual, WhatIsHeardIsTheSameWithAnyNumberOfThreadsAndInGroups) {
  const std::string expected = heard_on_a_virtual_clock(1, {"main", "main", "main"});
  for (const auto& at : {Places{"main", "main", "main"}, Places{"red", "blue", "main"}, Places{"red", "red", "blue"}}) {
    for (const std::size_t threads : {1U, 2U, 8U}) {
      EXPECT_EQ(heard_on_a_virtual_clock(threads, at), expected) << threads << " threads, a in " << at.a;
    }
  }
}

}  // namespace
}  // namespace fiona::conformance
