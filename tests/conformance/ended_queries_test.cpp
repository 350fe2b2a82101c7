// Nothing of a query is left when it has ended, in whichever way (docs/patterns.md, Query).
#include <gtest/gtest.h>

#include <map>
#include <string>

#include "fiona/error.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

class QueriesThatHaveEnded : public OverTransports {
 protected:
  /// Requests that a port has open at most: so many less are open as it takes fewer.
  static constexpr std::uint64_t kMostOpen = 4096;
  static constexpr std::uint64_t kAtOnce = 100;
  static constexpr std::uint64_t kRounds = 5;
  static constexpr std::uint64_t kPayload = 8192;

  void SetUp() override {
    system.load_client("questioner", "asker");
    for (const std::string name : {"first", "second"}) system.load_provider("answerer", name);
    wire_all("first");
  }
  void wire_all(const std::string& provider) {
    system.wire("asker.echo", provider + ".echo");
    system.wire("asker.failing_echo", provider + ".echo");
    system.wire("asker.lookup", provider + ".lookup");
  }
  /// Begins so many of this manner; they are kept once this returns, if they are.
  void begin(const std::string& port, const std::string& manner, double deadline_ms = 60'000) {
    system.set("asker", "deadline_ms=" + std::to_string(deadline_ms));
    EXPECT_EQ(system.call("asker.ask", "manner=" + port + ":" + manner + " number=" + std::to_string(kAtOnce), 30'000)
                  .outcome(),
              "ok");
  }
  void wait_until_kept(const std::string& provider) {
    system.eventually("they are kept", [&] { return system.read(provider + ".open").value() >= kAtOnce; });
  }
  /// So many more have ended so, and none is open.
  void wait_for_ends(const std::string& outcome) {
    ends[outcome] += kAtOnce;
    system.eventually("the ends of those that are " + outcome, [&] {
      auto told = system.read("asker.ends").payload();
      return told.ends_with(" open=0") &&
             told.find(outcome + "=" + std::to_string(ends[outcome]) + " ") != std::string::npos;
    });
  }
  /// Over and over: one that has ended may still be on its way there.
  void let_go(const std::string& provider) {
    system.eventually("it keeps none", [&] {
      return system.call(provider + ".echo", "manner=forget").outcome() == "ok" &&
             system.read(provider + ".open").value() == 0;
    });
  }
  /// In every way in which a query ends.
  void make_all_end() {
    begin("echo", "promptly");
    wait_for_ends("ok");
    begin("lookup", "later");
    wait_for_ends("ok");
    begin("echo", "drop");
    wait_for_ends("rejected");
    begin("echo", "error");
    wait_for_ends("rejected");
    begin("echo", "never", 5);
    wait_for_ends("timeout");
    let_go("first");
    begin("lookup", "never");
    wait_until_kept("first");
    system.set("asker", "cancel=port");
    wait_for_ends("cancelled");
    system.set("asker", "cancel=none");
    let_go("first");
    begin("failing_echo", "never");
    wait_until_kept("first");
    system.wire("asker.failing_echo", "second.echo");
    wait_for_ends("disconnected");
    let_go("first");
    begin("lookup", "second");  // answered by that one alone
    wait_until_kept("first");
    system.wire("asker.lookup", "second.lookup");
    wait_for_ends("ok");
    let_go("first");
    begin("echo", "never");
    wait_until_kept("first");
    system.wire("asker.echo", "second.echo");
    EXPECT_EQ(system.call("first.echo", "manner=release").outcome(), "ok");
    wait_for_ends("ok");
    begin("echo", "never");
    wait_until_kept("second");
    system.unwire("asker.echo");
    wait_for_ends("disconnected");
    let_go("second");
    begin("lookup", "never");
    wait_until_kept("second");
    system.state("asker", "neutral");
    wait_for_ends("not_active");
    system.state("asker", "active");
    let_go("second");
    begin("failing_echo", "never");
    wait_until_kept("second");
    system.unload("second");
    wait_for_ends("disconnected");
    system.load_provider("answerer", "second");
    wire_all("first");
  }
  std::uint64_t room_of(const std::string& port) {
    const auto called = system.call("asker.room", "manner=" + port, 30'000);
    const auto result = system.system().types().make(called.result().type());
    result->ParseFromString(called.result().object());
    return result->GetReflection()->GetUInt64(*result, result->GetDescriptor()->FindFieldByName("number"));
  }
  /// Of the processes here: over tcp the asker's is another host's.
  std::uint64_t memory() {
    std::uint64_t sum = 0;
    const auto snapshot = system.system().snapshot();
    for (const auto& group : snapshot.groups()) sum += group.memory();
    return sum;
  }

  std::map<std::string, std::uint64_t> ends;
};

TEST_P(QueriesThatHaveEnded, LeaveNothingOpenAndKeepNeitherRoomNorCredit) {
  system.set("asker", "payload=" + std::to_string(kPayload));
  make_all_end();
  const std::uint64_t memory_before = memory();
  for (std::uint64_t i = 0; i < kRounds; ++i) make_all_end();
  constexpr std::uint64_t kAsked = 12 * kAtOnce * kRounds * kPayload;
  if (!FIONA_SANITIZED) {  // which keeps what was freed
    EXPECT_LT(memory(), memory_before + kAsked / 2) << "bytes of what was asked are kept";
  }

  // One that is larger than a wire holds goes when nothing that cost credit is left, and so does its answer.
  const auto big = [&] {
    system.set("asker", "payload=5000000 deadline_ms=60000");
    EXPECT_EQ(system.call("asker.ask", "manner=echo:promptly number=1", 30'000).outcome(), "ok");
    ++ends["ok"];
    system.eventually("its answer", [&] {
      const auto told = system.read("asker.ends").payload();
      return told.ends_with(" open=0") && told.find("ok=" + std::to_string(ends["ok"]) + " ") != std::string::npos;
    });
    system.set("asker", "payload=" + std::to_string(kPayload));
  };
  big();
  for (const std::string port : {"echo", "failing_echo", "lookup"}) {
    EXPECT_EQ(room_of(port), kMostOpen) << port;
    system.eventually("all are known to be given up",
                      [&] { return system.read("first.open").value() == system.read("first.abandoned").value(); });
    let_go("first");
  }
  big();
  system.eventually("nothing waits", [&] {
    return system.read("first.queue_depth").value() + system.read("second.queue_depth").value() == 0;
  });
}

TEST_P(QueriesThatHaveEnded, BecauseTheirProviderFailedAreDisconnectedThoughTheyWaitedForItsHandler) {
  begin("echo", "throw");
  system.eventually("their ends", [&] { return system.read("asker.ends").payload().ends_with(" open=0"); });
  EXPECT_EQ(system.read("asker.ends").payload(), "disconnected=99 rejected=1 open=0") << "one had no answer";
  EXPECT_EQ(system.instance("first").mode(), "failed");
}

FIONA_OVER_EVERY_TRANSPORT(QueriesThatHaveEnded);

}  // namespace
}  // namespace fiona::conformance
