// What a death, a silence, foreign bytes and a pulled cable do between hosts.
#include <arpa/inet.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iostream>
#include <string>

#include "cable.hpp"
#include "fiona/trust/host_keys.hpp"
#include "hosts_fixture.hpp"

namespace fiona::host {
namespace {

using conformance::Cable;

TEST_F(Hosts, DeathOfAHostIsNoticedAndEndsItsWires) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "source", "source", "period_ms=5");
  system.load_in("", "sink", "sink");
  system.wire("sink.each", "source.newest");
  system.eventually("messages come", [&] { return system.port("sink.each").messages() > 10; });
  ::kill(other.process(), SIGKILL);
  const auto begin = Steady::now();
  system.eventually("lost", [&] { return system.port("sink.each").connection() == control::LOST; });
  const double noticed_ms = ms_since(begin);
  RecordProperty("noticed_ms", static_cast<int>(noticed_ms));
  std::cout << "death of a host noticed after " << noticed_ms << " ms\n";
  EXPECT_EQ(system.port("sink.each").reason(), "the connection to host 'far' has ended");
  system.eventually("failed", [&] { return system.instance("source").mode() == "failed"; });
  other.restart();
  system.join("far");
  EXPECT_EQ(system.instance("source").reason(), "host 'far' was started anew");
  system.unload("source");
  system.load_in("far", "source", "source", "period_ms=5");
  system.wire("sink.each", "source.newest");
  system.eventually("flows again", [&] { return system.port("sink.each").connection() == control::CONNECTED; });
}

TEST_F(Hosts, HostThatFallsSilentAndComesBackGoesOnAndWhatWasMissedIsCounted) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  wire_source_to_sink(system);
  ::kill(other.process(), SIGSTOP);
  system.eventually("silent", [&] { return system.host("far").state() == "silent"; });
  EXPECT_EQ(system.port("sink.each").connection(), control::LOST);
  ::kill(other.process(), SIGCONT);
  const auto begin = Steady::now();
  system.eventually("back", [&] { return system.port("sink.each").connection() == control::CONNECTED; });
  std::cout << "back after " << ms_since(begin) << " ms\n";
  expect_nothing_lost_silently(system);
  EXPECT_EQ(system.instance("sink").mode(), "active") << "it went on";
}

/// A machine that is suspended, or a virtual one whose processors are taken away.
TEST_F(Hosts, MachineThatStandsStillTakesNobodyForDeadWhenItGoesOn) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  const pid_t all[] = {::getpid(), other.process()};
  const pid_t stopper = ::fork();
  if (stopper == 0) {
    for (const pid_t one : all) ::kill(one, SIGSTOP);
    ::usleep(2'000'000);
    for (const pid_t one : all) ::usleep(100'000), ::kill(one, SIGCONT);
    ::_exit(0);
  }
  ASSERT_EQ(::waitpid(stopper, nullptr, 0), stopper);
  const auto begun = Steady::now();
  system.eventually("it would have been noticed", [&] { return Steady::now() - begun > 1500ms; });
  EXPECT_EQ(system.host("far").state(), "joined");
  EXPECT_GT(system.host("far").since_s(), 3) << "it was lost meanwhile";
  EXPECT_THAT(other.said(), Not(HasSubstr("silent")));
}

TEST_F(Hosts, WhatIsUnloadedWhileItsHostIsSilentIsGoneWhenThatIsBack) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  wire_source_to_sink(system);
  ::kill(other.process(), SIGSTOP);
  system.eventually("silent", [&] { return system.host("far").state() == "silent"; });
  system.unload("sink");
  ::kill(other.process(), SIGCONT);
  system.join("far");
  system.load_in("far", "sink", "sink");
  EXPECT_EQ(system.instance("sink").mode(), "active") << "the name is free again";
}

TEST_F(Hosts, ForeignBytesOnThePortChangeNothing) {
  OtherHost other(directory.path, "far");
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  wire_source_to_sink(system);
  const std::string zmtp_null("\xff\0\0\0\0\0\0\0\1\x7f\3\0NULL", 16);
  for (const std::string& bytes :
       {std::string("GET / HTTP/1.1\r\n\r\n"), std::string(100'000, '\xff'), std::string(5000, '\0'),
        zmtp_null + std::string(48, '\0') + std::string(3000, 'x')}) {
    const int client = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port =
        htons(static_cast<std::uint16_t>(std::stoi(other.address().substr(other.address().find(':') + 1))));
    ASSERT_EQ(::connect(client, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    static_cast<void>(::send(client, bytes.data(), bytes.size(), MSG_NOSIGNAL));
    ::close(client);
  }
  const auto so_far = system.port("sink.each").messages();
  system.eventually("messages go on", [&] { return system.port("sink.each").messages() > so_far + 100; });
  EXPECT_EQ(system.host("far").state(), "joined");
  expect_nothing_lost_silently(system);
  EXPECT_EQ(system.port("sink.each").dropped(), 0U);
}

/// A socket that takes connections and closes them: a host that is there and no host of ours.
TEST_F(Hosts, HostsThatCannotJoinTryAgainAtMostSoOften) {
  constexpr int kPeers = 50;
  const int server = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ASSERT_EQ(::bind(server, reinterpret_cast<sockaddr*>(&address), size), 0);
  ASSERT_EQ(::listen(server, 512), 0);
  ASSERT_EQ(::getsockname(server, reinterpret_cast<sockaddr*>(&address), &size), 0);
  HostOptions options{directory.path / "keys", "", {}};
  const std::string key = trust::KeyDirectory(options.keys).make().open.text();
  for (int i = 0; i < kPeers; ++i) {
    options.peers.push_back(PeerAddress::from_text(
        "p" + std::to_string(i) + "=127.0.0.1:" + std::to_string(ntohs(address.sin_port)) + "=" + key));
  }
  RunningSystem system(options);
  const auto begin = Steady::now();
  int late = 0;
  system.eventually(
      "20 s pass",
      [&] {
        for (int one = 0; (one = ::accept(server, nullptr, nullptr)) >= 0; ::close(one))
          late += ms_since(begin) > 2'000;
        return ms_since(begin) > 20'000;
      },
      30s);
  ::close(server);
  std::cout << late / 18.0 << " attempts a second of " << kPeers << " hosts\n";
  EXPECT_GT(late, 0);
  EXPECT_LE(late / 18.0, 50.0 * kPeers / 200) << "200 hosts together at most 50 a second";
}

/// How soon is for the campaign, which has the machine for itself.
class Partitions : public Hosts, public testing::WithParamInterface<std::chrono::seconds> {};

TEST_P(Partitions, BothSidesShowTheFaultAndAreBackWithNothingLostSilently) {
  Cable cable;
  if (!cable.missing().empty()) GTEST_SKIP() << cable.missing();
  OtherHost other(directory.path, "far", {.listen = cable.there() + ":0", .network = cable.network()});
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  wire_source_to_sink(system);
  cable.pull();
  const auto pulled = Steady::now();
  system.eventually("noticed", [&] { return system.host("far").state() == "silent"; });
  std::cout << "noticed after " << ms_since(pulled) << " ms\n";
  EXPECT_EQ(system.port("sink.each").connection(), control::LOST);
  system.eventually(
      "the outage ends", [&] { return Steady::now() - pulled > GetParam(); }, 20s);
  cable.plug();
  const auto plugged = Steady::now();
  system.eventually("the other side has shown it",
                    [&] { return other.said().find("which leads, has been silent for 1") != std::string::npos; });
  system.eventually("this side as well, and is back", [&] {
    const auto port = system.port("sink.each");
    return port.connection() == control::CONNECTED && port.dropped() > 0;
  });
  std::cout << "an outage of " << GetParam().count() << " s: back after " << ms_since(plugged) << " ms\n";
  expect_nothing_lost_silently(system);
}

INSTANTIATE_TEST_SUITE_P(Of, Partitions, testing::Values(2s, 10s),
                         [](const auto& one) { return std::to_string(one.param.count()) + "Seconds"; });

}  // namespace
}  // namespace fiona::host
