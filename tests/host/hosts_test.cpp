// Several hosts over tcp: who is let in, who leads, and how wires pass between their groups.
#include <fmt/format.h>
#include <signal.h>

#include <array>
#include <filesystem>
#include <fstream>
#include <memory>
#include <set>
#include <sstream>
#include <string>

#include "fiona/result.hpp"
#include "fiona/trust/host_keys.hpp"
#include "hosts_fixture.hpp"

namespace fiona::host {
namespace {

/// The tcp sockets of a process that listen.
std::size_t listening(pid_t process) {
  std::set<std::string> inodes;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/" + std::to_string(process) + "/fd")) {
    std::error_code ignored;
    const std::string target = std::filesystem::read_symlink(entry.path(), ignored).string();
    if (target.starts_with("socket:[")) inodes.insert(target.substr(8, target.size() - 9));
  }
  std::size_t found = 0;
  for (const std::string table : {"tcp", "tcp6"}) {
    std::ifstream file("/proc/" + std::to_string(process) + "/net/" + table);
    for (std::string line; std::getline(file, line);) {
      std::istringstream words(line);
      std::array<std::string, 10> column;
      for (auto& one : column) words >> one;
      if (column[3] == "0A" && inodes.contains(column[9])) ++found;
    }
  }
  return found;
}

TEST_F(Hosts, NoTcpSocketListensUnlessItIsAskedFor) {
  RunningSystem closed(Transport::Ipc);
  closed.load_client("sink", "sink");
  EXPECT_EQ(listening(::getpid()), 0U);
  const OtherHost open(directory.path, "far");
  EXPECT_EQ(listening(open.process()), 1U) << "so that the count means something";
}

TEST_F(Hosts, TcpWithoutKeysIsRefusedInASentenceThatSaysHow) {
  const Error error = error_of([&] {
    RunningSystem system(HostOptions{directory.path / "none", "tcp://127.0.0.1:0", {}});
  });
  EXPECT_EQ(error.text().what, "tcp needs keys, and this user has none");
  EXPECT_EQ(error.text().next, "fiona keys make");
}

TEST_F(Hosts, HostThatLeadsIsNotLed) {
  OtherHost other(directory.path, "far");
  HostOptions both = other.led_from(directory.path / "test");
  both.listen = "tcp://127.0.0.1:0";
  EXPECT_THAT(error_of([&] { RunningSystem system(both); }).text().what,
              HasSubstr("--peer and --listen do not go together"));
}

TEST_F(Hosts, UnknownKeyIsRefusedCountedAndToldHowToBeLetIn) {
  OtherHost other(directory.path, "far");
  HostOptions stranger = other.led_from(directory.path / "known");
  stranger.keys = directory.path / "stranger";
  const std::string key = trust::KeyDirectory(stranger.keys).make().open.text();
  RunningSystem system(stranger);
  system.eventually("refused", [&] { return system.host("far").state() == "refused"; });
  EXPECT_THAT(system.host("far").reason(), HasSubstr("fiona keys allow NAME " + key));
  system.eventually("told on the other side", [&] {
    return other.said().find("refused a host at 127.0.0.1, 1 times so far") != std::string::npos;
  });
  EXPECT_EQ(error_of([&] { system.load_in("far", "sink", "sink"); }).code(), ErrorCode::Unreachable);
}

TEST_F(Hosts, KeyThatIsAllowedLaterIsLetInWithoutARestart) {
  OtherHost other(directory.path, "far");
  HostOptions stranger = other.led_from(directory.path / "known");
  stranger.keys = directory.path / "stranger";
  const std::string key = trust::KeyDirectory(stranger.keys).make().open.text();
  RunningSystem system(stranger);
  system.eventually("refused", [&] { return system.host("far").state() == "refused"; });
  trust::KeyDirectory(other.keys()).allow("stranger", key);
  system.join("far");
}

TEST_F(Hosts, ForgottenKeyLosesItsSession) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  trust::KeyDirectory(other.keys()).forget("test");
  system.eventually("out", [&] { return system.host("far").state() != "joined"; });
}

TEST_F(Hosts, ReplacedKeyLosesItsSessionThoughItsNameIsAllowed) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const std::string next = trust::KeyDirectory(directory.path / "next").make().open.text();
  trust::KeyDirectory(other.keys()).forget("test");
  trust::KeyDirectory(other.keys()).allow("test", next);
  system.eventually("out", [&] { return system.host("far").state() != "joined"; });
}

TEST_F(Hosts, HostWithAnotherKeyThanThePeerOptionSaysGetsNothing) {
  OtherHost other(directory.path, "far");
  HostOptions options = other.led_from(directory.path / "test");
  options.peers[0].key = trust::KeyDirectory(directory.path / "impostor").make().open;
  RunningSystem system(options);
  system.eventually("noticed", [&] { return !system.host("far").reason().empty(); });
  EXPECT_NE(system.host("far").state(), "joined");
  EXPECT_THAT(system.host("far").reason(), HasSubstr("its key is not the one that --peer names"));
}

TEST_F(Hosts, SecondLeaderIsRefusedNamesTheFirstAndTakesOverWhenThatHasGone) {
  OtherHost other(directory.path, "far");
  auto first = std::make_unique<RunningSystem>(other.led_from(directory.path / "first"));
  first->join("far");
  first->load_in("far", "sink", "sink");
  RunningSystem second(other.led_from(directory.path / "second"));
  second.eventually("refused", [&] { return second.host("far").state() == "refused"; });
  EXPECT_EQ(second.host("far").reason(), "host 'far' is led by 'first': one host leads at a time");
  first.reset();
  second.eventually(
      "leads", [&] { return second.host("far").state() == "joined"; }, 20s);
  second.load_in("far", "sink", "sink");
  EXPECT_EQ(second.instance("sink").mode(), "active") << "what the first had left is gone";
}

TEST_F(Hosts, LibraryThatIsInNoPackageIsTakenOnlyFromTheDirectoryOfTheOtherHost) {
  OtherHost other(directory.path, "far", {.plugins = false});
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const Error error = error_of([&] { system.load_in("far", "sink", "sink"); });
  EXPECT_EQ(error.text().what,
            "local/test-components is in no package, and host 'far' takes only what is installed on it");
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
}

TEST_F(Hosts, UnknownHostIsNamedWithThoseThatThereAre) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const Error error = error_of([&] { system.load_in("fra/group", "sink", "sink"); });
  EXPECT_EQ(error.text().what, "there is no host 'fra'");
  EXPECT_EQ(error.text().expected, "one of far");
}

TEST_F(Hosts, WiresOfGroupsArePassedOnByTheirHostsInBothDirections) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("near", "source", "here", "neutral period_ms=1 count=200");
  system.load_in("far/deep", "sink", "there");
  system.load_in("far/deep", "answerer", "answerer");
  system.load_in("near", "asker", "asker", "neutral count=50 period_ms=1 payload=1000");
  const auto report = system.watch("there.report");
  const auto outcome = system.watch("asker.outcome");
  system.wire("there.each", "here.newest");
  system.wire("asker.echo", "answerer.echo");
  EXPECT_EQ(system.port("there.each").transport(), "tcp");
  system.state("here", "active");
  EXPECT_EQ(system.wait_for(report, [](const auto& s) { return s.number() == 200; }).value(), 200 * 201 / 2);
  system.state("asker", "active");
  system.wait_for(outcome,
                  [](const auto& s) { return s.value() == static_cast<double>(Outcome::Ok) && s.payload() == "1000"; });
}

TEST_F(Hosts, PushToSeveralGroupsOfAnotherHostCrossesOnceInChunksAndArrivesWhole) {
  constexpr std::size_t kPayload = 1'000'000;
  constexpr int kCount = 20;
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("near", "source", "source",
                 fmt::format("neutral period_ms=100 count={} payload={}", kCount, kPayload));
  for (const std::string name : {"a", "b"}) system.load_in("far/deep", "sink", name);
  system.load_in("far", "sink", "c");
  const auto report = system.watch("a.report");
  for (const std::string name : {"a", "b", "c"}) system.wire(name + ".each", "source.newest");
  system.state("source", "active");
  EXPECT_EQ(system.wait_for(report, [](const auto& s) { return s.number() > 0; }).payload(), std::to_string(kPayload));
  for (const std::string name : {"a", "b", "c"}) {
    system.eventually("each message is accounted for", [&] {
      const auto sink = system.port(name + ".each");
      return sink.messages() + sink.dropped() == kCount;
    });
  }
  EXPECT_EQ(system.group("main").links().sent_bytes() / (kPayload * kCount), 1U) << "one crossing for the three";
  EXPECT_EQ(system.group("main").links().garbled() + system.group("main").links().not_granted(), 0U);
}

TEST_F(Hosts, EachQuestionHasAnOutcomeWhenMoreIsAskedThanRelaysHold) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far/deep", "answerer", "answerer");
  system.load_in("near", "asker", "asker", "neutral count=50 period_ms=1 payload=1000000");
  system.wire("asker.echo", "answerer.echo");
  system.state("asker", "active");
  system.eventually("each has ended", [&] { return system.port("asker.outcome").messages() == 50; });
  EXPECT_EQ(system.host("far").state(), "joined");
}

TEST_F(Hosts, GroupThatDiesOnTheOtherHostIsToldAndTheHostStaysJoined) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far/deep", "sink", "sink");
  system.load_in("", "source", "source", "period_ms=5");
  system.wire("sink.each", "source.newest");
  const pid_t group = group_of(other.process());
  ASSERT_GT(group, 0);
  ::kill(group, SIGKILL);
  system.eventually("told",
                    [&] { return system.instance("sink").reason().find("killed by signal 9") != std::string::npos; });
  EXPECT_EQ(system.instance("sink").mode(), "failed");
  EXPECT_EQ(system.host("far").state(), "joined");
  system.unload("sink");
  system.load_in("far/deep", "sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("flows again", [&] { return system.port("sink.each").messages() > 0; });
}

TEST_F(Hosts, GroupOfAnotherHostEndsOnceTheLastInstanceHasLeftItAndStartsAnewWhenItIsNamedAgain) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const auto group = [&] { return group_of(other.process()); };
  system.load_in("", "source", "source", "period_ms=5");
  system.load_in("far/deep", "sink", "sink");
  const pid_t first = group();
  ASSERT_GT(first, 0);
  system.unload("sink");
  system.eventually("it ends", [&] { return group() == 0; });
  system.load_in("far/deep", "sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("messages come", [&] { return system.port("sink.each").messages() > 10; });
  EXPECT_NE(group(), first);
}

TEST(Peer, IsNamedWithAddressAndKey) {
  const auto peer = PeerAddress::from_text("kitchen=10.0.0.2:7001=" + std::string(64, 'a'));
  EXPECT_EQ(peer.name, "kitchen");
  EXPECT_EQ(peer.address, "tcp://10.0.0.2:7001");
  for (const std::string wrong :
       {"kitchen", "kitchen=10.0.0.2:7001", "=10.0.0.2:7001=", "main=h:1=", "k=h=", "k=h:="}) {
    const std::string text = wrong.ends_with('=') ? wrong + std::string(64, 'a') : wrong;
    EXPECT_EQ(error_of([&] { PeerAddress::from_text(text); }).code(), ErrorCode::Usage) << text;
  }
}

}  // namespace
}  // namespace fiona::host
