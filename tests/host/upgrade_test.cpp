// Another version of an instance takes its place while it runs; a bad one does not, or not for long. And nobody waits
// for what a component does in its life-cycle calls.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <iostream>

#include "fiona/error.hpp"
#include "versions_fixture.hpp"

namespace fiona::host {
namespace {

using conformance::LaterAnswer;
using conformance::Versions;
using testing::HasSubstr;
using testing::StartsWith;
using namespace std::chrono_literals;
using Steady = std::chrono::steady_clock;

/// It ticks, and answers who asks: nearby and in another process.
class Upgrade : public Versions {
 protected:
  Upgrade() {
    make(load_of("cage"));
    system.load_in("", "witness", "near");
    system.load_in("apart", "witness", "far");
    system.load_in("", "sink", "orders");
    for (const std::string witness : {"near", "far"}) {
      wire(witness + ".samples", "x.samples");
      wire(witness + ".echo", "x.echo");
    }
    wire("orders.leased", "x.leased");
    wire("x.orders", "orders.orders");
  }
  void expect_first_goes_on() {
    EXPECT_EQ(version_heard(), 1);
    EXPECT_EQ(system.instance("x").group(), "cage");
    EXPECT_EQ(system.instance("x").mode(), "active");
    EXPECT_EQ(system.port("near.samples").connection(), control::CONNECTED);
    EXPECT_EQ(system.port("near.echo").connection(), control::CONNECTED);
    system.eventually("what was tried has gone", [&] {
      return groups() == std::vector<std::string>{"apart", "cage", "main"};
    });
  }
};

TEST_F(Upgrade, PutsTheNewVersionInThePlaceOfTheOldOneAndTheOldOneGoes) {
  build("version=2");
  const control::Done done = make(upgrade_of());
  EXPECT_EQ(done.note(), "local/versioned 0 in place of 0, in x");
  EXPECT_EQ(done.switched(), 5U);
  EXPECT_EQ(done.lost(), 0U);
  EXPECT_EQ(version_heard(), 2);
  EXPECT_EQ(system.instance("x").group(), "x");
  for (const std::string port : {"near.samples", "near.echo", "far.samples", "far.echo", "orders.leased", "x.orders"})
    EXPECT_EQ(system.port(port).connection(), control::CONNECTED) << port;
  system.eventually("the old process has gone", [&] {
    serve();
    return groups() == std::vector<std::string>{"apart", "main", "x"};
  });
}

TEST_F(Upgrade, KeepsParametersAndMode) {
  control::Change set;
  set.mutable_set()->set_instance("x");
  conformance::add_arguments("period_ms=7", *set.mutable_set()->mutable_parameters());
  make(set);
  system.state("x", "neutral");
  control::Change state;
  state.mutable_state()->set_instance("x");
  state.mutable_state()->set_mode("neutral");
  make(state);
  build("version=2");
  make(upgrade_of());
  EXPECT_EQ(system.instance("x").mode(), "neutral");
  EXPECT_EQ(system.instance("x").set_parameters(0).value().number(), 7);
}

TEST_F(Upgrade, IsRefusedWhereNothingElseIsThere) {
  const Error error = refusal_of(upgrade_of());
  EXPECT_EQ(error.text().what, "'x' runs what is installed already: local/versioned 0");
  EXPECT_EQ(error.text().next, "build it anew");
}

TEST_F(Upgrade, IsATransactionOfItsOwn) {
  build("version=2");
  control::Transact request;
  *request.add_changes() = upgrade_of();
  request.add_changes()->mutable_unload()->set_instance("near");
  auto answer = std::make_shared<LaterAnswer>();
  engine.transact("test", request, [answer](control::Reply reply) {
    answer->reply = std::move(reply);
    answer->ended = true;
  });
  EXPECT_EQ(end_of(answer).failure().what(), "an upgrade is a transaction of its own");
}

TEST_F(Upgrade, IsPlannedWithItsReverse) {
  build("version=2");
  const control::Reply reply = end_of(begin(upgrade_of(), true));
  ASSERT_EQ(reply.planned().steps_size(), 1);
  EXPECT_EQ(reply.planned().steps(0).upgrade().group(), "x");
  EXPECT_EQ(reply.planned().reverse(0).upgrade().group(), "cage");
  EXPECT_EQ(system.instance("x").group(), "cage");
}

TEST_F(Upgrade, ToOneWithoutAPortThatIsUsedIsRefusedBeforeItIsStarted) {
  build("version=2", "readings");
  const Error error = refusal_of(upgrade_of());
  EXPECT_EQ(error.text().what, "local/versioned 0 cannot take the place of 0: 'x' has no port 'samples' that provides");
  EXPECT_THAT(error.text().expected, HasSubstr("readings"));
  expect_first_goes_on();
}

TEST_F(Versions, OneThatTakesATextForAPathIsForWhoMayNameFiles) {
  plugin.build("version=1", "", false);
  make(load_of("cage"));
  const Rights rights{trust::Access::Compose, trust::Access::Compose, "boss"};
  const auto told = [&](const control::Change& change) {
    control::Transact request;
    *request.add_changes() = change;
    auto answer = std::make_shared<LaterAnswer>();
    const auto ended = [answer](control::Reply reply) {
      answer->reply = std::move(reply);
      answer->ended = true;
    };
    engine.transact("test", request, ended, std::nullopt, rights);
    return end_of(answer);
  };
  control::Change set;
  set.mutable_set()->set_instance("x");
  conformance::add_arguments("notes=/home/me/notes", *set.mutable_set()->mutable_parameters());
  ASSERT_TRUE(told(set).has_done());
  build("version=2");
  EXPECT_EQ(told(upgrade_of()).failure().what(),
            "set x notes needs the level administer (9), and 'boss' has compose (6)");
  EXPECT_EQ(system.instance("x").group(), "cage");
}

struct Bad {
  std::string behaviour;
  std::string why;
};
void PrintTo(const Bad& bad, std::ostream* out) { *out << bad.behaviour; }

std::string name_of(const testing::TestParamInfo<Bad>& tested) {
  std::string name = tested.param.behaviour;
  std::erase_if(name, [](char c) { return !std::isalnum(static_cast<unsigned char>(c)); });
  return name;
}

class UpgradeToABadOne : public Upgrade, public testing::WithParamInterface<Bad> {};

TEST_P(UpgradeToABadOne, IsNotMadeAndSaysWhy) {
  build("version=2 " + GetParam().behaviour);
  const auto begun = Steady::now();
  const Error error = refusal_of(upgrade_of());
  const std::chrono::duration<double> took = Steady::now() - begun;
  std::cout << "refused after " << took.count() << " s (5)\n";
  EXPECT_EQ(error.text().what, "'x' was not upgraded to 0: the version before goes on");
  EXPECT_THAT(error.text().found, HasSubstr(GetParam().why));
  expect_first_goes_on();
  build("version=3");
  make(upgrade_of());
  EXPECT_EQ(version_heard(), 3);
}

INSTANTIATE_TEST_SUITE_P(
    Each, UpgradeToABadOne,
    testing::Values(Bad{"dies_when_opened=1", "has ended group 'x' while it was loaded: killed by signal 6"},
                    Bad{"dies_in_start=1", "has ended group 'x' while it was loaded: killed by signal 6"},
                    Bad{"refuses=1", "the antenna does not fit"},
                    Bad{"hangs_in_start=1", "'x' did not reach its mode within 4.5 s"},
                    Bad{"silent=1", "its port leased says nothing, where the one before said "},
                    Bad{"silent=1 fails_after_ms=100", "the antenna fell off"},
                    Bad{"silent=1 dies_after_ms=100", "group 'x' killed by signal 6"},
                    Bad{"silent=1 hangs_after_ms=100", "group 'x' was ended: 'x' was stuck"}),
    name_of);

TEST_F(Upgrade, RightAfterABadOneIsNotEndedWithWhatThatHasLeft) {
  build("version=2 dies_when_opened=1");
  static_cast<void>(refusal_of(upgrade_of()));
  build("version=3");
  const auto answer = begin(upgrade_of());
  system.eventually("it is made in the group whose name was that of the bad one", [&] {
    serve();
    return answer->ended.load();
  });
  EXPECT_EQ(answer->reply.failure().found(), "");
  EXPECT_EQ(system.instance("x").group(), "x");
  EXPECT_EQ(version_heard(), 3);
}

class UpgradeThatGoesWrongLater : public Upgrade, public testing::WithParamInterface<Bad> {};

TEST_P(UpgradeThatGoesWrongLater, IsTakenBackByItselfAndSaysWhy) {
  build("version=2 " + GetParam().behaviour);
  const Error error = refusal_of(upgrade_of(8000));
  EXPECT_EQ(error.code(), ErrorCode::ComponentFailed);
  EXPECT_EQ(error.text().what, "'x' 0 was taken back: 0 serves again");
  EXPECT_THAT(error.text().found, HasSubstr(GetParam().why));
  expect_first_goes_on();
  const auto journal = engine.journal(1);
  EXPECT_EQ(journal.entries(0).author(), "upgrade");
  EXPECT_THAT(journal.entries(0).reason(), HasSubstr(GetParam().why));
}

INSTANTIATE_TEST_SUITE_P(Each, UpgradeThatGoesWrongLater,
                         testing::Values(Bad{"dies_after_ms=1000", "group 'x' killed by signal 6"},
                                         Bad{"dies_after_ms=4000", "group 'x' killed by signal 6"},
                                         Bad{"hangs_after_ms=1000", "group 'x' was ended: 'x' was stuck"},
                                         Bad{"fails_after_ms=1000", "the antenna fell off"},
                                         Bad{"silent_after_ms=1000", "its port "}),
                         name_of);

TEST_F(Upgrade, ThatIsWatchedToTheEndIsToldThenAndTheOldOneGoes) {
  build("version=2");
  const auto answer = begin(upgrade_of(3000));
  system.eventually("the new one serves", [&] {
    serve();
    return system.instance("x").group() == "x";
  });
  EXPECT_EQ(system.instance("x").stands_by(), "0");
  EXPECT_FALSE(answer->ended);
  EXPECT_TRUE(end_of(answer).has_done());
  EXPECT_EQ(system.instance("x").stands_by(), "");
  system.eventually("the old process has gone", [&] {
    return groups() == std::vector<std::string>{"apart", "main", "x"};
  });
}

TEST_F(Upgrade, IsUndoneAtOnceWhileTheOldOneStandsBy) {
  build("version=2");
  const auto answer = begin(upgrade_of(60'000));
  system.eventually("the new one serves", [&] {
    serve();
    return system.instance("x").group() == "x";
  });
  control::Undo request;
  auto undone = std::make_shared<LaterAnswer>();
  engine.undo("test", request, [undone](control::Reply reply) {
    undone->reply = std::move(reply);
    undone->ended = true;
  });
  EXPECT_TRUE(end_of(undone).has_done()) << end_of(undone).failure().what();
  EXPECT_EQ(version_heard(), 1);
  EXPECT_THAT(end_of(answer).done().warnings(0), HasSubstr("another upgrade of it has begun meanwhile"));
}

TEST_F(Upgrade, ThatFailsWhileTheOneBeforeIsWatchedLeavesNothingThatStandsBy) {
  build("version=2");
  const auto first = begin(upgrade_of(60'000));
  system.eventually("it serves", [&] {
    serve();
    return system.instance("x").group() == "x";
  });
  build("version=3 refuses=1");
  static_cast<void>(refusal_of(upgrade_of()));
  EXPECT_THAT(end_of(first).done().warnings(0), HasSubstr("another upgrade of it has begun meanwhile"));
  EXPECT_EQ(system.instance("x").stands_by(), "");
  system.eventually("the first process has gone", [&] {
    serve();
    return groups() == std::vector<std::string>{"apart", "main", "x"};
  });
  build("version=2");  // which is what it is started with
  ::kill(system.group("x").process(), SIGKILL);
  system.eventually("it is started again", [&] {
    serve();
    return system.instance("x").restarts() == 1 && system.instance("x").mode() == "active";
  });
}

// ---- the one before ends meanwhile ----------------------------------------------------------------------------

/// What the next one is, and what the one before is started again as meanwhile.
struct Again {
  std::string name;
  std::string next;
  std::string again;
};
void PrintTo(const Again& again, std::ostream* out) { *out << again.name; }

class UpgradeOfOneThatEnds : public Upgrade, public testing::WithParamInterface<Again> {
 protected:
  /// The next one is on its way to its mode, and has read what it is.
  std::shared_ptr<LaterAnswer> begin_and_kill(const std::string& next, const std::string& again) {
    build(next);
    const auto answer = begin(upgrade_of());
    system.eventually("the next one is made", [&] {
      serve();
      return groups() == std::vector<std::string>{"apart", "cage", "main", "x"};
    });
    let_be(300ms);
    build(again);
    ::kill(system.group("cage").process(), SIGKILL);
    return answer;
  }
  void expect_each_wire_once() {
    for (const std::string port : {"near.samples", "near.echo", "far.samples", "far.echo", "orders.leased", "x.orders"})
      EXPECT_EQ(system.port(port).connection(), control::CONNECTED) << port;
    const auto put = system.port("x.samples").messages();
    const auto near = system.port("near.samples").messages();
    const auto far = system.port("far.samples").messages();
    let_be(1000ms);
    const auto most = system.port("x.samples").messages() - put + 10;
    EXPECT_LT(system.port("near.samples").messages() - near, most);
    EXPECT_LT(system.port("far.samples").messages() - far, most);
    EXPECT_NEAR(system.port("x.orders").since_s(), system.port("near.samples").since_s(), 0.5) << "wired again later";
  }
};

TEST_P(UpgradeOfOneThatEnds, TakesItsPlaceOnce) {
  const auto answer = begin_and_kill(GetParam().next, GetParam().again);
  EXPECT_TRUE(end_of(answer).has_done()) << end_of(answer).failure().what() << end_of(answer).failure().found();
  let_be(2500ms);  // in which the other one is made again, or is not
  EXPECT_EQ(version_heard(), 2);
  EXPECT_EQ(system.instance("x").group(), "x");
  EXPECT_EQ(system.instance("x").mode(), "active");
  expect_each_wire_once();
  system.eventually("the old process has gone", [&] {
    serve();
    return groups() == std::vector<std::string>{"apart", "main", "x"};
  });
}

INSTANTIATE_TEST_SUITE_P(Each, UpgradeOfOneThatEnds,
                         testing::Values(Again{"AndIsBackBefore", "version=2 start_ms=1500", "version=1"},
                                         Again{"AndIsBackAfter", "version=2 start_ms=1500", "version=1 start_ms=3000"},
                                         Again{"WhileTheNextOneIsChecked", "version=2 quiet_ms=1500",
                                               "version=1 start_ms=2500"}),
                         [](const auto& tested) { return tested.param.name; });

using UpgradeBesideARestart = UpgradeOfOneThatEnds;

TEST_F(UpgradeBesideARestart, ThatFailsLeavesTheRestartToItsEnd) {
  const auto answer = begin_and_kill("version=2 start_ms=1000 refuses=1", "version=3 start_ms=2500");
  EXPECT_THAT(end_of(answer).failure().found(), HasSubstr("the antenna does not fit"));
  system.eventually("it is back", [&] {
    serve();
    return system.instance("x").restarts() == 1 && system.instance("x").mode() == "active";
  });
  EXPECT_EQ(version_heard(), 3);
  expect_each_wire_once();
}

TEST_F(Upgrade, OfWhatOneThatHasFailedIsWiredToIsMade) {
  system.load_in("elsewhere", "caller", "caller");
  wire("caller.samples", "x.samples");
  system.set("caller", "call=throw go=1");
  system.eventually("it has failed", [&] { return system.instance("caller").mode() == "failed"; });
  build("version=2");
  make(upgrade_of());
  EXPECT_EQ(version_heard(), 2);
  EXPECT_EQ(system.port("caller.samples").connection(), control::LOST);
}

TEST_F(Upgrade, HearsAgainWhoWasStartedAgainMeanwhile) {
  system.load_in("shop", "ticker", "shop");
  wire("x.heard", "shop.samples");
  build("version=2 quiet_ms=1500");
  const auto answer = begin(upgrade_of());
  system.eventually("the next one is made", [&] {
    serve();
    return groups() == std::vector<std::string>{"apart", "cage", "main", "shop", "x"};
  });
  let_be(500ms);
  ::kill(system.group("shop").process(), SIGKILL);
  EXPECT_TRUE(end_of(answer).has_done()) << end_of(answer).failure().what() << end_of(answer).failure().found();
  EXPECT_EQ(system.instance("x").group(), "x");
  const auto heard = system.port("x.heard").superseded();
  system.eventually("it hears it", [&] {
    serve();
    const auto port = system.port("x.heard");
    return port.connection() == control::CONNECTED && port.superseded() > heard + 10;  // it does not look
  });
}

TEST_F(Upgrade, ThatIsTakenBackLeavesWhoCameIntoItsGroup) {
  build("version=2 dies_after_ms=2500");
  const auto answer = begin(upgrade_of(8000));
  system.eventually("the new one serves", [&] {
    serve();
    return system.instance("x").group() == "x";
  });
  std::ofstream(plugin.directory() / "versioned.share" / "behaviour") << "version=4";
  control::Change guest = load_of("x");
  guest.mutable_load()->set_instance("guest");
  make(guest);
  EXPECT_THAT(end_of(answer).failure().what(), HasSubstr("was taken back"));
  system.eventually("the guest is there again", [&] {
    serve();
    return system.instance("guest").mode() == "active";
  });
  EXPECT_EQ(version_heard(), 1);
  EXPECT_EQ(system.instance("x").group(), "cage");
}

TEST_F(Upgrade, ThatEndsInTheLastMomentOfItsWatchIsStartedAgain) {
  build("version=2");
  const auto answer = begin(upgrade_of(500));
  system.eventually("the new one serves", [&] {
    serve();
    return system.instance("x").group() == "x";
  });
  std::this_thread::sleep_for(700ms);  // its watch is over, and nobody has noted that
  ::kill(system.group("x").process(), SIGKILL);
  system.eventually("its end is seen", [&] { return system.instance("x").mode() == "failed"; });
  EXPECT_TRUE(end_of(answer).has_done());
  system.eventually("it is started again", [&] {
    serve();
    return system.instance("x").restarts() == 1 && system.instance("x").mode() == "active";
  });
  EXPECT_EQ(version_heard(), 2);
}

TEST_F(Upgrade, OfOneThatEndsAgainAndAgainMendsIt) {
  build("version=2 dies_after_ms=30");
  make([&] {
    control::Change change;
    change.mutable_unload()->set_instance("x");
    return change;
  }());
  make(load_of("other"));  // what the first process has opened stays open
  system.eventually("it is left", [&] {
    serve();
    return system.instance("x").reason().find("left") != std::string::npos;
  });
  build("version=3");
  make(upgrade_of());
  EXPECT_EQ(version_heard(), 3);
  EXPECT_EQ(system.port("near.samples").connection(), control::CONNECTED);
  EXPECT_EQ(system.port("far.echo").connection(), control::CONNECTED);
}

TEST_F(Upgrade, WhatIsWatchedIsWatchedOn) {
  const auto watch = system.watch("x.samples");
  const auto first = system.wait_for(watch, [](const auto& sample) { return sample.value() == 1; });
  build("version=2");
  make(upgrade_of());
  const auto next = system.wait_for(watch, [](const auto& sample) { return sample.value() == 2; });
  EXPECT_NE(next.opening, first.opening) << "its numbers begin anew";
}

// ---- nobody waits for a life-cycle call -----------------------------------------------------------------------

class SlowStart : public Versions {
 protected:
  /// Meanwhile: the longest time that a look at the system took.
  double longest_look_ms(const std::function<bool()>& until) {
    double longest = 0;
    system.eventually("its start", [&] {
      serve();
      const auto begun = Steady::now();
      system.system().snapshot();
      system.serve_groups(0ms);
      longest = std::max(longest, std::chrono::duration<double, std::milli>(Steady::now() - begun).count());
      return until();
    });
    return longest;
  }
};

TEST_F(SlowStart, OfALoadHoldsUpNobodyElse) {
  build("version=1 start_ms=3000");
  const auto answer = begin(load_of("cage"));
  EXPECT_LT(longest_look_ms([&] { return answer->ended.load(); }), 2000);
  EXPECT_TRUE(answer->reply.has_done()) << answer->reply.failure().what();
  EXPECT_EQ(version_heard(), 1);
}

TEST_F(SlowStart, OfARestartHoldsUpNobodyElseAndItsWiresComeBack) {
  build("version=1 start_ms=3000");
  make(load_of("cage"));
  system.load_in("", "witness", "near");
  wire("near.samples", "x.samples");
  ::kill(system.group("cage").process(), SIGKILL);
  EXPECT_LT(longest_look_ms([&] {
              const auto x = system.instance("x");
              return x.restarts() == 1 && x.mode() == "active";
            }),
            2000);
  EXPECT_EQ(system.port("near.samples").connection(), control::CONNECTED);
}

TEST_F(SlowStart, ThatIsRefusedLeavesNothing) {
  build("version=1 start_ms=200 refuses=1");
  const Error error = refusal_of(load_of("cage"));
  EXPECT_EQ(error.code(), ErrorCode::ComponentFailed);
  EXPECT_EQ(error.text().what, "'x' failed: the antenna does not fit");
  EXPECT_EQ(error.text().next, "'x' was not loaded: correct that, then load it again");
  EXPECT_EQ(system.system().snapshot().instances_size(), 0);
  system.eventually("its process has gone", [&] { return groups() == std::vector<std::string>{"main"}; });
}

TEST_F(SlowStart, ThatEndsItsGroupIsToldAsALoadThatDid) {
  build("version=1 start_ms=200 dies_in_start=1");
  const Error error = refusal_of(load_of("cage"));
  EXPECT_EQ(error.text().what, "plugin 'local/versioned' has ended group 'cage' while it was loaded");
  EXPECT_THAT(error.text().found, StartsWith("killed by signal 6"));
  EXPECT_EQ(system.system().snapshot().instances_size(), 0);
}

TEST_F(SlowStart, OfARestartEndsWhenItIsUnloadedMeanwhile) {
  build("version=1 start_ms=1500");
  make(load_of("cage"));
  ::kill(system.group("cage").process(), SIGKILL);
  system.eventually("it is started again", [&] {
    serve();
    return system.instance("x").restarts() == 1;
  });
  control::Change unload;
  unload.mutable_unload()->set_instance("x");
  make(unload);
  let_be(2000ms);
  EXPECT_EQ(system.system().snapshot().instances_size(), 0);
  build("version=2");
  make(load_of("cage2"));
  EXPECT_EQ(version_heard(), 2);
}

using SlowEnd = Versions;

TEST_F(SlowEnd, OfWhatHasBeenReplacedMayTakeAsLongAsThatOfAnyOther) {
  build("version=1 rest_ms=5000 stop_ms=9000");
  make(load_of("cage"));
  build("version=2");
  make(upgrade_of(2500));  // its end comes while it goes to its rest
  system.eventually("the old process has gone", [&] {
    serve();
    return groups() == std::vector<std::string>{"main", "x"};
  });
  EXPECT_TRUE(std::filesystem::exists(plugin.directory() / "versioned.share" / "stopped"));
}

}  // namespace
}  // namespace fiona::host
