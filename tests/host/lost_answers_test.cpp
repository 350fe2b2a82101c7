// What a led host has done though its leader was not told is taken back when it joins again.
#include <arpa/inet.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "hosts_fixture.hpp"

namespace fiona::host {
namespace {

/// The way between a leader and a host that it leads, on which answers get lost.
class Way {
 public:
  explicit Way(const std::string& address) : host_(address_of(address.substr(address.find(':') + 1))) {
    listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in own = address_of("0");
    socklen_t size = sizeof own;
    if (::bind(listener_, reinterpret_cast<sockaddr*>(&own), size) != 0 || ::listen(listener_, 8) != 0 ||
        ::getsockname(listener_, reinterpret_cast<sockaddr*>(&own), &size) != 0)
      throw Error(ErrorCode::Failed, "no way");
    address_ = "tcp://127.0.0.1:" + std::to_string(ntohs(own.sin_port));
    thread_ = std::thread([this] { serve(); });
  }
  ~Way() {
    ends_ = true;
    thread_.join();
    close_all();
    ::close(listener_);
  }
  const std::string& address() const { return address_; }
  /// What the host says from now on is lost.
  void lose_answers() { loses_answers_ = true; }
  void cut() { state_ = State::Cut; }
  /// What comes from now on goes both ways: by connections that are made anew.
  void mend() { state_ = State::Mended; }

 private:
  enum class State { Whole, Cut, Mended };
  static sockaddr_in address_of(const std::string& port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(port)));
    return address;
  }
  void close_all() {
    for (const auto& [leader, host] : ends_of_) ::close(leader), ::close(host);
    ends_of_.clear();
  }
  void accept() {
    const int leader = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
    const int host = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const bool connected = ::connect(host, reinterpret_cast<const sockaddr*>(&host_), sizeof host_) == 0;
    if (connected && state_ != State::Cut) {
      ends_of_.emplace_back(leader, host);
    } else {
      ::close(leader), ::close(host);
    }
  }
  bool pass_on(int from, int to, bool loses) {
    char bytes[65536];
    const ssize_t count = ::recv(from, bytes, sizeof bytes, MSG_DONTWAIT);
    if (count < 0) return errno == EAGAIN;
    return count > 0 && (loses || ::send(to, bytes, static_cast<std::size_t>(count), MSG_NOSIGNAL) == count);
  }
  void serve() {
    while (!ends_) {
      if (state_ != State::Whole) close_all();
      if (State mended = State::Mended; state_.compare_exchange_strong(mended, State::Whole)) loses_answers_ = false;
      std::vector<pollfd> waits{{listener_, POLLIN, 0}};
      for (const auto& [leader, host] : ends_of_) waits.insert(waits.end(), {{leader, POLLIN, 0}, {host, POLLIN, 0}});
      ::poll(waits.data(), waits.size(), 20);
      std::erase_if(ends_of_, [this](const auto& one) {
        const auto& [leader, host] = one;
        const bool goes_on = pass_on(leader, host, false) && pass_on(host, leader, loses_answers_);
        if (!goes_on) ::close(leader), ::close(host);
        return !goes_on;
      });
      if (waits[0].revents != 0) accept();
    }
  }

  const sockaddr_in host_;
  int listener_ = -1;
  std::string address_;
  std::vector<std::pair<int, int>> ends_of_;
  std::atomic<bool> loses_answers_{false};
  std::atomic<State> state_{State::Whole};
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

/// Two sources of one sink, in one group of the other host.
class LostAnswers : public Hosts {
 protected:
  void SetUp() override {
    system.join("far");
    system.load_in("far/deep", "source", "first", "period_ms=5");
    system.load_in("far/deep", "source", "second", "neutral period_ms=5");
    system.load_in("far/deep", "sink", "sink");
    system.wire("sink.each", "first.newest");
  }
  /// It was done there, and nobody is told.
  template <class F>
  void lose_the_answer_to(F request) {
    way.lose_answers();
    EXPECT_EQ(error_of(request).code(), ErrorCode::Unreachable);
    way.mend();
    system.join("far");
  }
  HostOptions by_the_way() {
    HostOptions options = other.led_from(directory.path / "test");
    options.peers[0].address = way.address();
    return options;
  }
  std::string period_of_first() {
    std::string period;
    const auto first = system.instance("first");
    for (const auto& one : first.parameters()) {
      if (one.name() == "period_ms") period = one.value();
    }
    return period;
  }
  void expect_messages() {
    const auto so_far = system.port("sink.each").messages();
    system.eventually("messages come", [&] { return system.port("sink.each").messages() > so_far + 10; });
  }
  OtherHost other{directory.path, "far"};
  Way way{other.address()};
  RunningSystem system{by_the_way(), RunningSystem::RestartsGroups{}};
};

TEST_F(LostAnswers, ParametersAreAsTheyWere) {
  const std::string before = period_of_first();
  lose_the_answer_to([&] { system.set("first", "period_ms=7"); });
  system.eventually("as it was", [&] { return period_of_first() == before; });
  EXPECT_FALSE(before.empty());
}

TEST_F(LostAnswers, ModeIsAsItWas) {
  lose_the_answer_to([&] { system.begin_state("first", "neutral"); });
  system.eventually("as it was", [&] { return system.instance("first").mode() == "active"; });
  system.state("first", "neutral");
  EXPECT_EQ(system.instance("first").mode(), "neutral") << "what is asked for and answered stays";
}

TEST_F(LostAnswers, WhatIsDeactivatedStaysSo) {
  system.state("first", "deactivated");
  control::State noted;
  noted.set_instance("first");
  noted.set_mode("deactivated");
  system.system().note_state(noted);
  lose_the_answer_to([&] { system.set("second", "period_ms=7"); });
  system.let_pass(std::chrono::seconds(3));
  EXPECT_EQ(system.instance("first").mode(), "deactivated");
}

TEST_F(LostAnswers, WhatFailsWhileTheConnectionIsCutIsToldWhenItJoinsAgain) {
  control::WaitMode failed;
  failed.set_instance("first");
  failed.set_mode("failed");
  failed.set_within_ms(60'000);
  const auto told = std::make_shared<conformance::LaterAnswer>();
  system.system().waits().wait_mode(7, 1, failed, [told](control::Reply reply) {
    told->reply = std::move(reply);
    told->ended = true;
  });
  lose_the_answer_to([&] { system.set("first", "fail_with=broken"); });
  system.eventually("it is told", [&] { return told->ended.load(); });
  EXPECT_TRUE(told->reply.has_met()) << told->reply.ShortDebugString();
  EXPECT_NE(system.port("sink.each").connection(), control::CONNECTED);
  EXPECT_THAT(system.port("sink.each").reason(), HasSubstr("has failed"));
}

TEST_F(LostAnswers, WireIsAsItWas) {
  lose_the_answer_to([&] { system.wire("sink.each", "second.newest"); });
  expect_messages();
}

TEST_F(LostAnswers, WireThatWasNoneIsNone) {
  system.unwire("sink.each");
  lose_the_answer_to([&] { system.wire("sink.each", "first.newest"); });
  system.eventually("as it was", [&] { return system.port("sink.each").connection() == control::UNWIRED; });
}

TEST_F(LostAnswers, GroupThatEndsWhileTheConnectionIsCutIsStartedAgain) {
  way.cut();
  system.eventually("cut", [&] { return system.host("far").state() == "silent"; });
  ::kill(group_of(other.process()), SIGKILL);
  system.eventually("it has ended", [&] { return group_of(other.process()) == 0; });
  way.mend();
  system.join("far");
  system.eventually("it is back", [&] { return system.instance("sink").mode() == "active"; });
  expect_messages();
}

}  // namespace
}  // namespace fiona::host
