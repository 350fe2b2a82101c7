// More of push newest and push timed (docs/patterns.md), and what a change of mode means to what comes in.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/result.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using PushNewest = OverTransports;
using PushTimed = OverTransports;

TEST_P(PushNewest, ThirtyTimesRealTimeOfAnInertialSensorReachesEachHandlerWithoutAGap) {
  system.load_client("listener", "listener");
  system.load_provider("source", "source", "neutral period_ms=0.33 count=3000");
  system.wire("listener.samples", "source.newest");
  system.state("source", "active");
  system.eventually("all heard", [&] { return system.port("listener.samples").messages() == 3000; });
  EXPECT_FALSE(system.read("listener.disorder").has_value) << system.read("listener.disorder").payload();
  EXPECT_EQ(system.port("listener.samples").dropped(), 0U);
}

TEST_P(PushNewest, PrescaleOfALiveWireMayBeChanged) {
  system.load_client("sink", "sink");
  system.load_provider("source", "source", "neutral period_ms=1 count=10");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  system.eventually("ten", [&] { return system.port("sink.each").messages() == 10; });
  system.wire("sink.each", "source.newest", 10);
  EXPECT_EQ(system.port("sink.each").prescale(), 10U);
  system.set("source", "count=110");
  system.state("source", "neutral");
  system.state("source", "active");
  system.eventually("all put", [&] { return system.port("source.newest").messages() == 110; });
  system.eventually("ten more", [&] { return system.port("sink.each").messages() == 20; });
}

TEST_P(PushNewest, ChangedPrescaleOfAStreamLosesNothingAndBringsNothingTwice) {
  system.load_client("listener", "listener");
  system.load_provider("source", "source", "neutral period_ms=0.5 count=2000");
  system.wire("listener.samples", "source.newest");
  system.state("source", "active");
  for (int i = 0; i < 100; ++i) {
    system.wire("listener.samples", "source.newest", 2);
    system.wire("listener.samples", "source.newest", 1);
  }
  system.eventually("all put", [&] { return system.port("source.newest").messages() == 2000; });
  system.eventually("all heard", [&] { return system.read("listener.queue_depth").value() == 0; });
  EXPECT_FALSE(system.read("listener.disorder").has_value) << system.read("listener.disorder").payload();
  EXPECT_LE(system.read("listener.step").value(), 2) << "each second, at the most";
  EXPECT_EQ(system.port("listener.samples").dropped(), 0U);
}

TEST_P(PushNewest, SeveralClientsOfOneProviderEachGetAll) {
  system.load_provider("source", "source", "neutral period_ms=1 count=100");
  for (const std::string name : {"a", "b", "c"}) {
    system.load_client("sink", name);
    system.wire(name + ".each", "source.newest");
  }
  system.state("source", "active");
  for (const std::string name : {"a", "b", "c"})
    system.eventually(name, [&] { return system.port(name + ".each").messages() == 100; });
}

TEST_P(PushNewest, WaitUpdateGivesTheNextMessageAndNotTheOneThatIsThere) {
  system.load_client("caller", "caller");
  system.load_provider("source", "source", "neutral period_ms=1 count=1");
  system.wire("caller.samples", "source.newest");
  system.state("source", "active");
  system.eventually("put", [&] { return system.port("caller.samples").messages() == 1; });
  const auto outcomes = system.watch("caller.outcome");
  system.set("caller", "call=wait_update go=1 deadline_ms=50");
  EXPECT_EQ(system.wait_for(outcomes, [](const auto& one) { return one.number() == 1; }).value(),
            static_cast<double>(Outcome::Timeout));
}

// ---- modes ----------------------------------------------------------------------------------------------------

class Inputs : public OverTransports {
 protected:
  Outcome latest(const std::string& call = "latest") {
    system.set("caller", "call=" + call + " go=" + std::to_string(++go));
    return static_cast<Outcome>(
        static_cast<int>(system.wait_for(outcomes, [&](const auto& one) { return one.number() == go; }).value()));
  }
  std::uint64_t outcomes = 0;
  std::uint64_t go = 0;
};

TEST_P(Inputs, OfTheModeBeforeDoNotEnterTheNextOne) {
  system.load_client("caller", "caller");
  system.load_provider("source", "source", "neutral period_ms=1 count=1");
  outcomes = system.watch("caller.outcome");
  system.wire("caller.samples", "source.newest");
  system.state("source", "active");
  system.eventually("put", [&] { return latest() == Outcome::Ok; });
  system.state("caller", "neutral");
  system.state("caller", "active");
  EXPECT_EQ(latest(), Outcome::NoData);
}

TEST_P(Inputs, ThatWaitForAHandlerEndWithTheirModeCounted) {
  system.load_client("sink", "sink", "work_ms=100");
  system.load_provider("source", "source", "neutral period_ms=1 count=50");
  system.wire("sink.each", "source.newest");
  system.state("source", "active");
  system.eventually("many wait", [&] { return system.read("sink.each.queue_depth").value() > 30; });
  system.state("sink", "neutral");
  system.eventually("none waits", [&] { return system.read("sink.each.queue_depth").value() == 0; });
  EXPECT_GT(system.read("sink.each.not_active").value(), 20);
}

TEST_P(Inputs, OfAServiceThatSpeaksOnChangeAreThereInTheNextModeThoughTheyCameBeforeIt) {
  system.load_client("sink", "sink", "neutral");
  system.load_provider("source", "source", "neutral period_ms=1 count=1");
  system.wire("sink.last", "source.last");
  system.state("source", "active");
  system.eventually("put", [&] { return system.port("source.last").messages() == 1; });
  const auto report = system.watch("sink.report");
  system.state("sink", "active");
  EXPECT_EQ(system.wait_for(report, [](const auto& one) { return one.number() > 0; }).value(), 1);
}

TEST_P(Inputs, OfAServiceThatSpeaksOnChangeAreGivenAgainAtEachEntryThoughTheyWereReceivedBefore) {
  system.load_client("sink", "sink");
  system.load_client("caller", "caller");
  system.load_provider("source", "source", "neutral period_ms=1 count=1");
  outcomes = system.watch("caller.outcome");
  const auto report = system.watch("sink.report");
  for (const std::string client : {"sink", "caller"}) system.wire(client + ".last", "source.last");
  system.state("source", "active");
  system.wait_for(report, [](const auto& one) { return one.number() == 1; });
  system.eventually("put", [&] { return latest("latest_last") == Outcome::Ok; });
  for (const std::string mode : {"neutral", "active"}) {
    for (const std::string client : {"sink", "caller"}) system.state(client, mode);
  }
  EXPECT_EQ(system.wait_for(report, [](const auto& one) { return one.number() == 2; }).value(), 2)
      << "the first, again";
  EXPECT_EQ(latest("latest_last"), Outcome::Ok);
}

// ---- push timed -----------------------------------------------------------------------------------------------

TEST_P(PushTimed, ClientCanAskForTheCycleOfItsProvider) {
  system.load_client("follower", "follower");
  system.eventually("unwired", [&] { return system.read("follower.outcome").payload() == "unwired"; });
  system.load_provider("metronome", "metronome");
  system.load_provider("source", "source");
  system.wire("follower.samples", "source.timed");
  system.eventually("20 ms, as the service says", [&] { return system.read("follower.cycle").value() == 20; });
  system.wire("follower.samples", "metronome.samples");
  system.eventually("40 ms, its own", [&] { return system.read("follower.cycle").value() == 40; });
}

TEST_P(PushTimed, ProviderThatStopsTellsItsSubscribersAndThoseThatCome) {
  system.load_client("sink", "sink");
  system.load_client("sink", "late");
  system.load_provider("metronome", "metronome");
  system.wire("sink.timed", "metronome.samples");
  system.eventually("produced", [&] { return system.port("sink.timed").messages() > 2; });
  system.set("metronome", "stopped=true");
  // On a busy machine it may have been lost for a silence before.
  system.eventually("told", [&] {
    const auto port = system.port("sink.timed");
    return port.connection() == control::LOST && port.reason() == "metronome.samples has stopped";
  });
  EXPECT_EQ(system.read("metronome.put_outcome").payload(), "not_active");
  system.wire("late.timed", "metronome.samples");
  system.eventually("told, too", [&] { return system.port("late.timed").connection() == control::LOST; });
  const auto produced = system.port("metronome.samples").messages();
  system.load_provider("source", "clock", "period_ms=10 count=20");
  system.eventually("200 ms have passed", [&] { return system.port("clock.newest").messages() == 20; });
  EXPECT_EQ(system.port("metronome.samples").messages(), produced);
}

TEST_P(PushTimed, ProviderThatStartsAgainHasItsSubscribersBack) {
  system.load_client("sink", "sink");
  system.load_provider("metronome", "metronome", "stopped=true");
  system.wire("sink.timed", "metronome.samples");
  system.eventually("told", [&] { return system.port("sink.timed").connection() == control::LOST; });
  system.set("metronome", "stopped=false");
  system.eventually("back", [&] { return system.port("sink.timed").connection() == control::CONNECTED; });
  system.eventually("produced", [&] { return system.port("sink.timed").messages() > 2; });
  EXPECT_EQ(system.read("metronome.put_outcome").payload(), "ok");
}

TEST_P(PushTimed, LateAndMissedCyclesAreProbesOfTheHull) {
  system.load_client("metronome", "metronome", "work_ms=100");
  system.eventually("missed", [&] { return system.read("metronome.samples.overruns").value() >= 2; });
  EXPECT_EQ(system.read("metronome.samples.late").unit, "ms");
  // A period of 20 ms, on a strand that is at work for 100 ms each time when a run is due.
  system.load_client("source", "busy", "period_ms=0.1 hang_ms=100");
  system.eventually("it is late by a good part of that work",
                    [&] { return system.read("busy.timed.late").value() > 10; });
  EXPECT_LT(system.read("busy.timed.late").value(), 10'000) << "in ms";
  // Of one that nothing holds up some run is punctual.
  system.load_client("source", "idle", "count=1");
  system.eventually("it has run", [&] { return system.read("idle.timed.runs").value() > 2; });
  system.eventually("punctual", [&] { return system.read("idle.timed.late").value() < 10; });
}

FIONA_OVER_EVERY_TRANSPORT(Inputs);

}  // namespace
}  // namespace fiona::conformance
