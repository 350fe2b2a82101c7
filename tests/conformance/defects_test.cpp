// What is known to go wrong in other frameworks for these patterns, and must not here. Each test is named after what
// does not happen. Those that are sentences of docs/patterns.md anyway stand with them: sentences.txt, the last
// section.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <thread>
#include <utility>

#include "fiona/error.hpp"
#include "fiona/result.hpp"
#include "holders.hpp"
#include "served_host.hpp"
#include "stopped_process.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::HasSubstr;

class Defects : public OverTransports {
 protected:
  std::string refusal_of(const std::function<void()>& request) {
    try {
      request();
    } catch (const Error& error) {
      return error.text().what;
    }
    return "";
  }
  void expect_puts(const std::string& source, std::uint64_t count) {
    const auto before = system.port(source + ".newest").messages();
    system.eventually(source + " puts", [&] { return system.port(source + ".newest").messages() >= before + count; });
  }
  /// No state is put to an activation any more.
  void eventually_untested() {
    system.eventually("no activation is left", [&] {
      const double before = system.read("source.tested").value();
      expect_puts("source", 5);
      return system.read("source.tested").value() == before;
    });
  }
  void begin(const std::string& call, const std::string& parameters = "") {
    system.set("caller", "call=" + call + " go=" + std::to_string(++go) + (parameters.empty() ? "" : " " + parameters));
  }
  SeenSample end() {
    return system.wait_for(outcomes, [this](const SeenSample& one) { return one.number() == go; });
  }
  Outcome outcome_of(const std::string& call, const std::string& parameters = "") {
    begin(call, parameters);
    return static_cast<Outcome>(static_cast<int>(end().value()));
  }
  /// Its first question, which its provider has when the deadline comes.
  void give_up_a_question() {
    begin("query", "manner=never deadline_ms=1000");
    system.eventually("it is kept", [&] { return system.read("answerer.open").value() == 1; });
    EXPECT_EQ(static_cast<Outcome>(static_cast<int>(end().value())), Outcome::Timeout);
  }
  void load_caller() {
    system.load_client("caller", "caller");
    outcomes = system.watch("caller.outcome");
  }
  std::uint64_t outcomes = 0;
  std::uint64_t go = 0;
};

// ---- connections ----------------------------------------------------------------------------------------------

TEST_P(Defects, AConnectThatFailsDoesNotCostTheOldConnection) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source");
  system.wire("sink.each", "source.newest");
  EXPECT_NE(refusal_of([&] { system.wire("sink.each", "source.timed"); }), "");
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
  const auto before = system.port("sink.each").messages();
  system.eventually("it goes on", [&] { return system.port("sink.each").messages() > before + 3; });
}

TEST_P(Defects, TheEndOfAnOldServerDoesNotEndTheConnectionToTheNewOne) {
  system.load_client("sink", "sink");
  system.load_provider("source", "old");
  system.load_provider("source", "fresh");
  system.wire("sink.each", "old.newest");
  system.wire("sink.each", "fresh.newest");
  system.unload("old");
  EXPECT_EQ(system.port("sink.each").connection(), control::CONNECTED);
  const auto before = system.port("sink.each").messages();
  system.eventually("it goes on", [&] { return system.port("sink.each").messages() > before + 3; });
}

TEST_P(Defects, DisconnectingTwiceHarmsNothing) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source");
  system.wire("sink.each", "source.newest");
  system.unwire("sink.each");
  EXPECT_THAT(refusal_of([&] { system.unwire("sink.each"); }), HasSubstr("sink.each"));
  system.wire("sink.each", "source.newest");
  system.eventually("it works", [&] { return system.port("sink.each").messages() > 3; });
}

TEST_P(Defects, APatternThatDoesNotMatchIsNotReportedAsAServiceThatIsNotThere) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source");
  const auto refusal = refusal_of([&] { system.wire("sink.each", "source.bell"); });
  EXPECT_THAT(refusal, HasSubstr("push newest"));
  EXPECT_THAT(refusal, HasSubstr("event"));
}

TEST_P(Defects, ASecondInstanceOfANameDoesNotStealTheClientsOfTheFirst) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "period_ms=1");
  system.wire("sink.each", "source.newest");
  EXPECT_THAT(refusal_of([&] { system.load_client("source", "source", "neutral"); }), HasSubstr("'source'"));
  const auto before = system.port("sink.each").messages();
  system.eventually("the first goes on", [&] { return system.port("sink.each").messages() > before + 3; });
}

TEST_P(Defects, AnIncompatibleProviderThatComesLaterIsNotConnectedByItsName) {
  system.load_client("sink", "sink");
  system.wire("sink.each", "source.bell");
  EXPECT_NE(refusal_of([&] { system.load_provider("source", "source"); }), "");
  EXPECT_EQ(system.port("sink.each").connection(), control::WAITING);
}

TEST_P(Defects, BothEndsKnowOfAWireAndOfItsEnd) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source");
  system.wire("sink.each", "source.newest");
  ASSERT_EQ(system.port("source.newest").clients_size(), 1);
  EXPECT_EQ(system.port("source.newest").clients(0).instance(), "sink");
  EXPECT_EQ(system.port("sink.each").peer().instance(), "source");
  system.eventually("its provider has it", [&] { return system.read("source.subscribers").value() == 1; });
  system.unwire("sink.each");
  EXPECT_EQ(system.port("source.newest").clients_size(), 0);
  system.eventually("its provider has let go of it", [&] { return system.read("source.subscribers").value() == 0; });
}

class DefectsOfTheDeaf : public Defects {};

TEST_P(DefectsOfTheDeaf, AConnectThatTakesLongDoesNotHoldUpTheCallsOfItsPort) {
  system.load_client("asker", "asker", "period_ms=5");
  system.load_provider("answerer", "answerer");
  system.load_in("deaf", "answerer", "deaf");
  system.wire("asker.echo", "answerer.echo");
  system.eventually("answers come", [&] { return system.port("asker.outcome").messages() > 3; });
  const auto outcomes = system.watch("asker.outcome");
  const auto begun = std::chrono::steady_clock::now();
  const pid_t deaf = system.group("deaf").process();
  stop_process(deaf);
  std::jthread waker([deaf] {
    std::this_thread::sleep_for(700ms);  // of the second after which it would be given up
    ::kill(deaf, SIGCONT);
  });
  system.wire("asker.echo", "deaf.echo");
  const auto took = std::chrono::steady_clock::now() - begun;
  ASSERT_GE(took, 700ms);
  const auto told = system.take(outcomes);
  const auto answers = std::count_if(told.begin(), told.end(), [](const SeenSample& one) {
    return static_cast<int>(one.value()) == static_cast<int>(Outcome::Ok);
  });
  EXPECT_GT(answers, took / 5ms / 20) << "of the provider that it has until then";
}

// ---- send and query -------------------------------------------------------------------------------------------

TEST_P(Defects, AnAnswerAfterTheClientGaveUpReachesNobody) {
  load_caller();
  system.load_provider("answerer", "answerer");
  system.wire("caller.echo", "answerer.echo");
  give_up_a_question();
  EXPECT_EQ(system.call("answerer.echo", "manner=release").outcome(), "ok");
  EXPECT_EQ(outcome_of("query", "manner=promptly deadline_ms=5000"), Outcome::Ok);
  EXPECT_TRUE(system.take(outcomes).empty()) << "the first one has its outcome already";
}

TEST_P(Defects, AnUnansweredQueryIsNotKeptByItsServerForEver) {
  load_caller();
  system.load_provider("answerer", "answerer");
  system.wire("caller.echo", "answerer.echo");
  give_up_a_question();
  system.eventually("its deadline", [&] { return system.read("answerer.abandoned").value() == 1; });
  ASSERT_EQ(outcome_of("request", "deadline_ms=5000"), Outcome::Ok);
  system.eventually("asked", [&] { return system.read("answerer.open").value() == 2; });
  EXPECT_EQ(outcome_of("discard"), Outcome::Ok);
  system.eventually("discarded", [&] { return system.read("answerer.abandoned").value() == 2; });
  begin("query");
  system.eventually("asked", [&] { return system.read("answerer.open").value() == 3; });
  system.unwire("caller.echo");
  system.eventually("unwired", [&] { return system.read("answerer.abandoned").value() == 3; });
  system.wire("caller.echo", "answerer.echo");
  begin("query");
  system.eventually("asked", [&] { return system.read("answerer.open").value() == 4; });
  system.unload("caller");
  system.eventually("the client has ended", [&] { return system.read("answerer.abandoned").value() == 4; });
}

TEST_P(Defects, AComponentThatHangsDoesNotHoldUpItsMasterForEver) {
  system.load_client("sink", "sink", "work_ms=5000");
  system.load_provider("source", "source", "neutral period_ms=1 count=1");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  system.eventually("it hangs", [&] { return system.port("sink.each").messages() == 1; });
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_THAT(refusal_of([&] { system.set("sink", "work_ms=0"); }), HasSubstr("in time"));
  EXPECT_LT(std::chrono::steady_clock::now() - begun, 4s);
}

TEST_P(Defects, CallersThatWantWhatAModeDoesNotServeHoldUpNoChange) {
  system.load_client("asker", "asker", "period_ms=1");
  system.load_provider("answerer", "answerer", "neutral");
  system.wire("asker.echo", "answerer.echo");
  system.eventually("it is asked", [&] { return system.read("answerer.echo.not_active").value() > 3; });
  for (int i = 0; i < 5; ++i) {
    const auto answered = system.port("answerer.echo").messages();
    system.state("answerer", "active");
    system.eventually("it answers", [&] { return system.port("answerer.echo").messages() > answered; });
    const auto refused = system.read("answerer.echo.not_active").value();
    system.state("answerer", "neutral");
    EXPECT_EQ(system.instance("answerer").mode(), "neutral");
    system.eventually("it is asked again", [&] { return system.read("answerer.echo.not_active").value() > refused; });
  }
}

TEST_P(Defects, WhatHearsThatItsModeEndsMayUseThePortsOfItsComponent) {
  load_caller();
  system.load_provider("answerer", "answerer");
  system.wire("caller.echo", "answerer.echo");
  begin("query_twice", "manner=never deadline_ms=5000");
  system.eventually("it is asked", [&] { return system.port("answerer.echo").messages() == 1; });
  system.state("caller", "deactivated");
  const SeenSample ended = end();
  EXPECT_EQ(ended.payload(), "cancelled") << "the first";
  EXPECT_EQ(static_cast<Outcome>(static_cast<int>(ended.value())), Outcome::Cancelled) << "the second";
}

TEST_P(Defects, WhatIsToldThatItEndsMayUseThePortsOfItsComponent) {
  system.load_client("sink", "neighbour");
  system.load_provider("source", "source", "period_ms=2");
  system.load_provider("source", "quiet", "neutral");
  system.load_provider("answerer", "answerer");
  system.load_provider("sink", "sink");
  const auto begin = [&] {
    system.load_client("leaver", "leaver", "neutral");
    system.wire("leaver.samples", "quiet.newest");
    system.wire("leaver.bell", "source.bell");
    system.wire("leaver.echo", "answerer.echo");
    system.wire("leaver.orders", "sink.orders");
    system.wire("sink.each", "leaver.report");
    system.state("leaver", "active");
  };
  begin();
  system.eventually("it waits for each", [&] {
    return system.read("answerer.open").value() == 1 && system.read("source.tested").value() > 0;
  });
  system.unload("leaver");
  system.eventually("it has used them", [&] { return !system.logged("leaver", "at its end:").empty(); });
  EXPECT_EQ(system.logged("leaver", "at its end:"),
            "at its end: send=not_active request=not_active latest=not_active discard=wrong_id deactivate=wrong_id");
  EXPECT_EQ(system.logged("leaver", "its stop failed"), "");
  system.eventually("its question is given up", [&] { return system.read("answerer.abandoned").value() == 1; });
  eventually_untested();
  EXPECT_EQ(system.port("answerer.echo").messages(), 1U);
  EXPECT_EQ(system.port("sink.orders").messages(), 0U);
  EXPECT_EQ(system.port("sink.each").messages(), 0U);
  EXPECT_EQ(system.call("neighbour.orders", "number=1").outcome(), "ok") << "it has taken nobody along";
  begin();
  system.eventually("it asks again", [&] { return system.port("answerer.echo").messages() == 2; });
}

// ---- push -----------------------------------------------------------------------------------------------------

TEST_P(Defects, SubscribingAgainDoesNotKeepTheFirstPrescale) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral period_ms=1 count=100");
  system.wire("sink.each", "source.newest", 50);
  system.wire("sink.each", "source.newest", 5);
  system.state("source", "active");
  system.eventually("each fifth", [&] { return system.port("sink.each").messages() == 20; });
}

TEST_P(Defects, NoPutIsDroppedBecauseItComesBeforeItsCycle) {
  system.load_client("sink", "sink");
  system.load_provider("metronome", "metronome", "neutral");
  system.wire("sink.timed", "metronome.samples");
  const auto reports = system.watch("sink.report");
  system.state("metronome", "active");
  for (int i = 1; i <= 20; ++i) system.set("metronome", "work_ms=" + std::to_string(i % 2));  // each puts once
  system.state("metronome", "neutral");
  const auto put = system.port("metronome.samples").messages();
  EXPECT_GE(put, 20U);
  const auto last = system.wait_for(reports, [put](const auto& one) { return one.number() == put; });
  EXPECT_EQ(last.value(), static_cast<double>(put * (put + 1) / 2)) << "the sum of their numbers";
}

TEST_P(Defects, AProducerThatIsSlowDoesNotHoldUpTheTimersOfOthers) {
  system.load_client("metronome", "slow", "work_ms=500");
  system.load_client("metronome", "quick");
  system.load_provider("sink", "sink");
  system.wire("sink.timed", "quick.samples");
  system.eventually("the slow one works", [&] { return system.instance("slow").tasks(0).runs() > 0; });
  // Again and again: six periods are a good part of that work, and a busy machine makes them longer.
  system.eventually("the quick one does not wait for it", [&] {
    const auto runs = system.instance("slow").tasks(0).runs();
    const auto before = system.port("sink.timed").messages();
    system.eventually("the quick one goes on", [&] { return system.port("sink.timed").messages() > before + 5; });
    return system.instance("slow").tasks(0).runs() <= runs + 1;
  });
}

// ---- event ----------------------------------------------------------------------------------------------------

TEST_P(Defects, ASingleEventThatHasFiredNeedsNoDeactivation) {
  load_caller();
  system.load_provider("source", "source", "period_ms=1");
  system.wire("caller.bell", "source.bell");
  ASSERT_EQ(outcome_of("activate", "every=3 single=true"), Outcome::Ok);
  ASSERT_EQ(outcome_of("event"), Outcome::Ok);
  eventually_untested();
}

TEST_P(Defects, ActivationsOfAClientThatUnwiresOrEndsDoNotStayAtTheServer) {
  load_caller();
  system.load_provider("source", "source", "period_ms=1");
  system.wire("caller.bell", "source.bell");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  system.unwire("caller.bell");
  eventually_untested();
  system.wire("caller.bell", "source.bell");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  system.unload("caller");
  eventually_untested();
}

TEST_P(Defects, AnEventWaitEndsAtItsDeadlineInBothModes) {
  load_caller();
  system.load_provider("source", "source");
  system.wire("caller.bell", "source.bell");
  for (const std::string single : {"true", "false"}) {
    ASSERT_EQ(outcome_of("activate", "every=0 single=" + single), Outcome::Ok);
    EXPECT_EQ(outcome_of("event", "deadline_ms=20"), Outcome::Timeout) << single;
    system.set("caller", "deadline_ms=10000");
  }
}

TEST_P(Defects, WhatOneActivationFiresHoldsNothingOfAnothers) {
  load_caller();
  system.load_client("caller", "other");
  system.load_provider("source", "source", "period_ms=2");
  for (const std::string client : {"caller", "other"}) system.wire(client + ".handled_bell", "source.bell");
  const std::uint64_t rings[] = {system.watch("caller.rings"), system.watch("other.rings")};
  ASSERT_EQ(outcome_of("activate_handled", "every=1 payload=500"), Outcome::Ok);
  ASSERT_EQ(outcome_of("activate_handled", "every=1 payload=0"), Outcome::Ok);
  system.set("other", "call=activate_handled go=1 every=1 payload=7");
  std::map<double, std::multiset<std::string>> fired;  // by each state
  system.eventually("all three fire in one put, again and again", [&] {
    for (const auto watch : rings) {
      for (const auto& one : system.take(watch)) fired[one.value()].insert(one.payload());
    }
    return std::count_if(fired.begin(), fired.end(), [](const auto& one) { return one.second.size() == 3; }) >= 20;
  });
  for (const auto& [state, sizes] : fired) {
    if (sizes.size() < 3) continue;
    EXPECT_THAT(sizes, ElementsAre("0", "500", "7")) << state;
  }
}

TEST_P(Defects, EventsThatFindNoRoomAreNotLostSilently) {
  load_caller();
  system.load_provider("source", "source", "period_ms=2");
  system.wire("caller.bell", "source.bell");
  ASSERT_EQ(outcome_of("activate", "every=1 payload=500000"), Outcome::Ok);
  system.eventually("more than it can keep", [&] { return system.port("caller.bell").dropped() > 10; });
  system.state("source", "neutral");
  std::uint64_t got = 0;
  std::uint64_t last = 0;
  for (;; ++got) {
    begin("event", "deadline_ms=2000");  // as long as none is on its way any more
    const auto one = end();
    if (one.value() != static_cast<double>(Outcome::Ok)) break;
    last = std::stoull(one.payload().substr(one.payload().find("of ") + 3));
  }
  EXPECT_GT(got, 0U);
  const std::uint64_t known = got + system.port("caller.bell").dropped();
  const std::uint64_t fired = static_cast<std::uint64_t>(system.read("source.tested").value());
  EXPECT_GE(known, last) << "each before the last that came has come or is counted";
  EXPECT_LE(known, fired) << "and counted once";
  EXPECT_GE(known + system.port("source.bell").dropped(), fired) << "those after it are known to one side at least";
}

// ---- state and triggers ---------------------------------------------------------------------------------------

TEST_P(Defects, AChangeToThePresentModeIsAnswered) {
  system.load_client("mover", "mover");
  system.state("mover", "drive");
  EXPECT_EQ(system.instance("mover").mode(), "drive");
}

/// Its calls race with those of others, from the moment when it is made.
class DefectsOfAStart : public testing::TestWithParam<Transport> {
 protected:
  ServedHost host{GetParam()};
  TestConsole console{host};
};

TEST_P(DefectsOfAStart, AModeThatAComponentAndAMasterAskForAtOnceIsAnsweredToBoth) {
  control::Change to_active;
  to_active.mutable_state()->set_instance("starter");
  to_active.mutable_state()->set_mode("active");
  for (int i = 0; i < 10; ++i) {
    for (const std::string mode : {"neutral", "active"}) {
      control::Change load = TestConsole::load_of("starter", host.place());
      load.mutable_load()->set_mode(mode);
      load.mutable_load()->add_rights("master");
      console.begin(load);
      console.begin(to_active);
      console.begin(to_active);
      for (int answer = 0; answer < 3; ++answer) EXPECT_TRUE(console.receive().has_done());
      const std::string ended =
          std::string("init not_active, ") + (mode == "neutral" ? "neutral not_active, " : "") + "active ok";
      console.eventually("each of its calls has ended", [&] { return console.read("starter.ended") == ended; });
      EXPECT_EQ(console.instance("starter").mode(), "active");
      console.unload("starter");
    }
  }
}

/// What the component itself sees is what is shown to others.
TEST_P(Defects, TheModeThatIsShownIsNotTheOneThatIsStillWaitedFor) {
  system.load_client("mover", "mover");
  system.load_provider("source", "source", "neutral");
  system.wire("mover.orders", "source.newest");
  system.eventually("it looks", [&] { return system.read("mover.sees").payload() == "drive"; });
  system.set("mover", "work_ms=60000");
  const auto change = [&] { return system.begin_state("mover", "park", 50); };
  system.eventually("it is blocked", [&] {
    const auto one = change();
    system.eventually("an answer", [&] { return one->ended.load(); });
    if (!one->reply.has_failure()) system.state("mover", "drive");
    // One that only comes too late fails, too.
    return one->reply.failure().what().find("blocked by task 'steer'") != std::string::npos;
  });
  const auto pending = system.begin_state("mover", "park");
  system.eventually("pending", [&] { return system.instance("mover").has_pending(); });
  const auto looks = system.port("mover.looks").messages();
  const auto seen = system.watch("mover.sees");
  system.eventually("it looks", [&] { return system.port("mover.looks").messages() > looks + 3; });
  for (const auto& one : system.take(seen)) EXPECT_EQ(one.payload(), "drive") << "to itself";
  EXPECT_EQ(system.read("mover.mode").payload(), "drive") << "to who watches";
  EXPECT_EQ(system.instance("mover").mode(), "drive") << "to who asks";
  EXPECT_FALSE(pending->ended);
  system.state("source", "active");
  system.eventually("the change", [&] { return pending->ended.load(); });
  EXPECT_EQ(system.read("mover.mode").payload(), "park");
  EXPECT_EQ(system.instance("mover").mode(), "park");
  system.eventually("it looks", [&] { return system.read("mover.sees").payload() == "park"; });
}

/// Nothing is read while it is half written: what is read later was put later.
TEST_P(Defects, ATaskThatReadsTheNewestValueWhileItIsPutNeverGoesBack) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "period_ms=0.2");
  const auto reads = system.watch("sink.latest_report");
  system.wire("sink.latest", "source.newest");
  std::uint64_t last = 0;
  std::uint64_t read = 0;
  system.wait_for(reads, [&](const auto& one) {
    EXPECT_GE(one.number(), last);
    read += one.number() > std::exchange(last, one.number()) ? 1 : 0;
    return read == 50;
  });
}

/// Nor is any part of it of another one: each field carries the same number, and a second look finds it as it was.
TEST_P(Defects, AValueThatATaskReadsWhileItIsPutIsWhole) {
  system.load_client("inspector", "inspector");
  system.load_provider("stamper", "stamper", "period_ms=0.1");
  for (const std::string port : {"each", "newest", "slot", "updates"}) {
    system.wire("inspector." + port, "stamper.samples");
  }
  system.eventually("many are read", [&] { return system.read("inspector.slot_seen").value() >= 300; });
  EXPECT_FALSE(system.read("inspector.torn").has_value) << system.read("inspector.torn").value();
  system.set("stamper", "value=1");
  system.eventually("one that is not whole would be seen", [&] { return system.read("inspector.torn").value() > 0; });
}

/// No wait ends, and no task starts, but by what it waits for: others are woken all the while.
TEST_P(Defects, AWaitThatIsWokenByNothingThatItWaitsForGoesOn) {
  load_caller();
  system.load_provider("source", "source", "period_ms=1");
  system.load_provider("source", "quiet", "neutral");
  system.load_provider("answerer", "answerer");
  system.wire("caller.samples", "quiet.newest");
  system.wire("caller.echo", "answerer.echo");
  system.wire("caller.handled_bell", "source.bell");
  ASSERT_EQ(outcome_of("activate_handled", "every=1"), Outcome::Ok);
  begin("wait_update");
  const auto waits = go;
  system.eventually("woken by others", [&] { return system.port("caller.rings").messages() > 50; });
  begin("query", "manner=promptly");
  EXPECT_EQ(system.wait_for(outcomes, [](const auto&) { return true; }).number(), go) << "the wait has not ended";
  system.set("quiet", "count=1");
  system.state("quiet", "active");
  const auto ended = system.wait_for(outcomes, [](const auto&) { return true; });
  EXPECT_EQ(ended.number(), waits);
  EXPECT_EQ(static_cast<Outcome>(static_cast<int>(ended.value())), Outcome::Ok);
}

/// Whatever holds the activity that a change leaves, and whatever comes for it meanwhile.
TEST_P(Defects, WhoComesForAnActivityThatAChangeWaitsForDoesNotBecomeItsHolder) {
  Holders holders(system);
  unsigned answered = 0;
  for (const auto& holder : Holders::kinds()) {
    SCOPED_TRACE(holder.name);
    std::map<std::string, std::uint64_t> not_active;
    for (const auto& kind : Holders::kinds()) {
      if (!kind.queue.empty()) not_active[kind.queue] = system.port("holder." + kind.queue).not_active();
    }
    holders.begin(holder);
    holders.wait_until_held({holder.name});
    const auto change = holders.begin_to_rest();
    holders.wait_until_blocked(*change, holder);
    const auto begun = holders.begun();
    for (const auto& kind : Holders::kinds()) {
      if (kind.name == holder.name) continue;
      holders.begin(kind);
      if (kind.queue.empty()) continue;
      system.eventually(kind.name + " has come",
                        [&] { return system.port("holder." + kind.queue).not_active() > not_active[kind.queue]; });
    }
    holders.wait_until_blocked(*change, holder);
    EXPECT_EQ(holders.held(), holder.name);
    holders.open(holder);
    holders.wait_until_it_rests(*change);
    EXPECT_EQ(holders.begun(), begun) << "nothing else has begun";
    if (holder.name != "trigger") {
      system.eventually("the call ends", [&] { return holders.turn().ended.load(); });
      EXPECT_EQ(holders.turn().reply.called().outcome(), "not_active");
    }
    const std::string ended = std::to_string(++answered) + (holder.name == "query" ? " ok" : " not_active");
    system.eventually("the question ends", [&] { return system.read("prompter.answered").payload() == ended; });
    for (const auto& kind : Holders::kinds()) {
      if (kind.queue.empty()) holders.open(kind);  // those that wanted to
    }
    system.state("holder", "work");
    EXPECT_EQ(holders.held(), "");
  }
}

TEST_P(Defects, SeveralMessagesWhileAHandlerIsBusyDoNotBecomeOne) {
  system.load_client("sink", "sink", "work_ms=10");
  system.load_provider("source", "source", "neutral period_ms=1 count=30");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  system.eventually("each is handled", [&] { return system.port("sink.each").messages() == 30; });
}

TEST_P(Defects, AComponentThatHangsAtItsEndDoesNotEndItsProcess) {
  system.load_client("sink", "sink", "work_ms=4000");
  system.load_client("sink", "neighbour");
  system.load_provider("source", "source", "neutral period_ms=1 count=1");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  system.eventually("it hangs", [&] { return system.port("sink.each").messages() == 1; });
  static_cast<void>(refusal_of([&] { system.unload("sink"); }));
  EXPECT_EQ(system.instance("neighbour").mode(), "active");
  EXPECT_EQ(system.call("neighbour.orders", "number=1").outcome(), "ok");
}

/// That its end waited for nothing was right only as long as it was stuck: here for longer than any machine is too busy
/// to see it.
TEST(Unload, OfOneThatWasStuckInMainAndHasComeBackLeavesNothingBehind) {
  RunningSystem system(host::HostOptions{}, RunningSystem::EndsHungGroups{});
  system.load_in("", "sink", "sink", "work_ms=10000");
  system.load_in("", "source", "source", "neutral count=1");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  system.eventually("it is given up", [&] { return system.instance("sink").mode() == "failed"; });
  system.eventually("it has come back", [&] { return system.read("sink.queue_depth").value() == 0; });
  control::Change change;
  change.mutable_unload()->set_instance("sink");
  EXPECT_THAT(system.system().perform(change).note(), Not(HasSubstr("did not come free")));
}

// ---- clients that vanish --------------------------------------------------------------------------------------

class DefectsOfTheKilled : public Defects {
 protected:
  void kill_clients() {
    ::kill(system.far_process(), SIGKILL);
    system.eventually("noticed", [&] { return system.instance("caller").mode() == "failed"; });
  }
};

TEST_P(DefectsOfTheKilled, AClientThatVanishesDoesNotStayAmongTheActivations) {
  load_caller();
  system.load_provider("source", "source", "period_ms=1");
  system.wire("caller.bell", "source.bell");
  ASSERT_EQ(outcome_of("activate", "every=0"), Outcome::Ok);
  kill_clients();
  eventually_untested();
}

TEST_P(DefectsOfTheKilled, AClientThatVanishesDoesNotStayAmongTheOpenQueries) {
  load_caller();
  system.load_provider("answerer", "answerer");
  system.wire("caller.echo", "answerer.echo");
  begin("query", "manner=never");
  system.eventually("asked", [&] { return system.read("answerer.open").value() == 1; });
  kill_clients();
  system.eventually("given up", [&] { return system.read("answerer.abandoned").value() == 1; });
}

TEST_P(DefectsOfTheKilled, AClientThatVanishesDoesNotStayAmongTheSubscribersNorFailLaterPuts) {
  load_caller();
  system.load_provider("source", "source", "period_ms=1");
  system.wire("caller.samples", "source.newest");
  system.eventually("received", [&] { return system.port("caller.samples").superseded() > 5; });
  kill_clients();
  system.eventually("nothing is sent any more", [&] {
    const auto before = system.group(system.providers_group()).links().sent_messages();
    expect_puts("source", 20);
    return system.group(system.providers_group()).links().sent_messages() < before + 20;
  });
  const auto dropped = system.port("source.newest").dropped();  // those that were put for it when it had died already
  expect_puts("source", 20);
  EXPECT_EQ(system.port("source.newest").dropped(), dropped);
  EXPECT_EQ(system.port("source.newest").refused(), 0U);
}

FIONA_OVER_EVERY_TRANSPORT(Defects);
FIONA_OVER_EVERY_TRANSPORT(DefectsOfAStart);
FIONA_OVER(DefectsOfTheDeaf, Transport::Ipc, Transport::Tcp);
FIONA_OVER(DefectsOfTheKilled, Transport::Ipc, Transport::Tcp);

}  // namespace
}  // namespace fiona::conformance
