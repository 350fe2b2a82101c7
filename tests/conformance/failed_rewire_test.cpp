// A rewire whose new wire is tried and does not open (docs/patterns.md, Wiring): the old one stays.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <filesystem>
#include <thread>
#include <utility>

#include "cable.hpp"
#include "engine.hpp"
#include "fiona/error.hpp"
#include "served_host.hpp"
#include "stopped_process.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

/// Why the command has failed; empty: it has not.
std::string refusal_of(RunningSystem& system, const std::string& client, const std::string& provider) {
  try {
    system.wire(client, provider);
  } catch (const Error& error) {
    return error.text().what + ": " + error.text().found;
  }
  return "";
}

/// The port hears everything from `old`, from its first sample on, as if nothing had been tried.
void expect_old_one_delivers(RunningSystem& system, std::uint64_t report) {
  const auto so_far = system.take(report);
  ASSERT_FALSE(so_far.empty()) << "nothing came while it was tried";
  const auto later =
      system.wait_for(report, [&](const SeenSample& one) { return one.number() > so_far.back().number() + 20; });
  const auto count = static_cast<double>(later.number());
  EXPECT_EQ(later.value(), count * (count + 1) / 2) << "the sum of all numbers: none lost, none twice";
}

void expect_old_one_is_wired(RunningSystem& system) {
  const auto port = system.port("sink.each");
  EXPECT_EQ(port.connection(), control::CONNECTED) << port.reason();
  EXPECT_EQ(port.peer().instance(), "old");
  EXPECT_EQ(port.dropped(), 0U);
}

class FailedRewire : public OverTransports {
 protected:
  void SetUp() override {
    system.load_client("sink", "sink");
    system.load_provider("source", "old", "neutral");
    system.load_in("deaf", "source", "fresh", "neutral");
    system.wire("sink.each", "old.newest");
    report = system.watch("sink.report");
    system.state("old", "active");
    system.eventually("it delivers", [&] { return system.port("sink.each").messages() > 10; });
    deaf = system.group("deaf").process();
  }
  void TearDown() override { go_on(); }
  /// Whoever looks at all groups would wait for one that stands.
  void go_on() {
    if (deaf > 0) ::kill(deaf, SIGCONT);
    deaf = 0;
  }

  std::uint64_t report = 0;
  pid_t deaf = 0;
};

TEST_P(FailedRewire, ToAProviderThatStandsStillLeavesTheOldWireAndSaysWhy) {
  stop_process(deaf);
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_THAT(refusal_of(system, "sink.each", "fresh.newest"), HasSubstr("'deaf' does not answer: silent for"));
  EXPECT_GE(std::chrono::steady_clock::now() - begun, 1s) << "it was tried";
  expect_old_one_delivers(system, report);
  go_on();
  expect_old_one_is_wired(system);
  system.eventually("it answers again", [&] { return refusal_of(system, "sink.each", "fresh.newest").empty(); });
  EXPECT_EQ(system.port("sink.each").peer().instance(), "fresh");
}

TEST_P(FailedRewire, ToAProviderThatIsKilledMeanwhileLeavesTheOldWireAndSaysWhy) {
  stop_process(deaf);
  const std::jthread killer([process = std::exchange(deaf, 0)] {
    std::this_thread::sleep_for(200ms);
    ::kill(process, SIGKILL);
  });
  EXPECT_THAT(refusal_of(system, "sink.each", "fresh.newest"), HasSubstr("killed by signal 9"));
  expect_old_one_delivers(system, report);
  expect_old_one_is_wired(system);
}

/// Here the provider has its part, and the client's process finds no way to it.
TEST_P(FailedRewire, ToAProviderWhoseLinkIsNotThereLeavesTheOldWireAndSaysWhy) {
  bool removed = false;
  for (const auto& one : std::filesystem::directory_iterator(system.directory() / "links")) {
    if (one.path().filename().string().find(".deaf.") != std::string::npos)
      removed = std::filesystem::remove(one.path() / "link");
  }
  ASSERT_TRUE(removed);
  EXPECT_THAT(refusal_of(system, "sink.each", "fresh.newest"), HasSubstr("the wire to fresh.newest did not open"));
  expect_old_one_delivers(system, report);
  expect_old_one_is_wired(system);
}

/// Neither of those that are wanted opens.
TEST_P(FailedRewire, OfAlternativesToProvidersThatDoNotOpenLeavesThemAsTheyWereAndSaysWhy) {
  system.load_provider("source", "other", "neutral");
  system.load_in("deaf", "source", "stale", "neutral");
  system.wire_to_several("sink.each", {"old.newest", "other.newest"});
  stop_process(deaf);
  try {
    system.wire_to_several("sink.each", {"fresh.newest", "stale.newest"});
    ADD_FAILURE() << "nobody serves now";
  } catch (const Error& error) {
    EXPECT_THAT(error.text().what, HasSubstr("'deaf' does not answer"));
  }
  EXPECT_THAT(refusal_of(system, "sink.each", "fresh.newest"), HasSubstr("'deaf' does not answer"));
  expect_old_one_delivers(system, report);
  go_on();
  expect_old_one_is_wired(system);
  ASSERT_EQ(system.port("sink.each").providers_size(), 2);
  EXPECT_EQ(system.port("sink.each").providers(1).provider().instance(), "other");
}

TEST_P(FailedRewire, InATransactionTakesBackTheWholeTransactionAndTheOldWireStays) {
  host::Engine engine(system.system(), "", [](const auto& job) { job(); });
  control::Transact request;
  *request.add_changes() = TestConsole::wire_of("sink.latest", "old.newest");
  *request.add_changes() = TestConsole::set_of("sink", "order_ms=7");
  *request.add_changes() = TestConsole::wire_of("sink.each", "fresh.newest");
  control::Reply reply;
  stop_process(deaf);
  engine.transact("test", request, [&reply](control::Reply one) { reply = std::move(one); });
  ASSERT_TRUE(reply.has_failure());
  EXPECT_EQ(reply.failure().change(), 3U);
  EXPECT_THAT(reply.failure().what(), HasSubstr("'deaf' does not answer"));
  EXPECT_EQ(engine.journal(1).entries(0).state(), control::JournalEntry::ROLLED_BACK);
  expect_old_one_delivers(system, report);
  go_on();
  expect_old_one_is_wired(system);
  EXPECT_EQ(system.port("sink.latest").connection(), control::UNWIRED);
  EXPECT_EQ(system.instance("sink").set_parameters_size(), 0);
}

FIONA_OVER_EVERY_TRANSPORT(FailedRewire);

/// The client and its old provider are here.
TEST(FailedRewireOfHosts, ToAProviderWhoseHostIsCutOffLeavesTheOldWireAndSaysWhy) {
  Cable cable;
  if (!cable.missing().empty()) GTEST_SKIP() << cable.missing();
  const TemporaryDirectory directory;
  OtherHost other(directory.path, "far", {.listen = cable.there() + ":0", .network = cable.network()});
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("", "sink", "sink");
  system.load_in("near", "source", "old", "neutral");
  system.load_in("far", "source", "fresh", "neutral");
  system.wire("sink.each", "old.newest");
  const auto report = system.watch("sink.report");
  system.state("old", "active");
  system.eventually("it delivers", [&] { return system.port("sink.each").messages() > 10; });
  cable.pull();
  EXPECT_THAT(refusal_of(system, "sink.each", "fresh.newest"), HasSubstr("host 'far' is not connected"));
  expect_old_one_delivers(system, report);
  expect_old_one_is_wired(system);
}

}  // namespace
}  // namespace fiona::conformance
