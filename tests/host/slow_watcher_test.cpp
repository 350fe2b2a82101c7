// Somebody who watches and does not read: nobody waits for him, and he is told what he lost.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <thread>

#include "control_server.hpp"
#include "fiona/probe.pb.h"
#include "system_fixture.hpp"

namespace fiona::host {
namespace {

using namespace std::chrono_literals;

class SlowWatcher : public testing::TestWithParam<std::string> {
 protected:
  SlowWatcher() : server_(socket_path(), System::Options{"slow", directory_.path / "store", directory_.path, 2}) {
    if (::pipe2(lifeline_, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    serving_ = std::thread([this] { server_.serve(lifeline_[0], -1); });
    connect();
  }
  void connect() {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, socket_path().c_str(), sizeof address.sun_path - 1);
    os::Descriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) throw std::runtime_error("no host");
    stream_ = std::make_unique<os::MessageStream>(std::move(socket));
  }
  ~SlowWatcher() override {
    ::close(lifeline_[1]);
    serving_.join();
    ::close(lifeline_[0]);
  }

  std::filesystem::path socket_path() const { return directory_.path / "private" / "slow.sock"; }
  control::Request request() {
    control::Request next;
    next.set_id(++sent_);
    return next;
  }
  void send(const control::Request& request) { ASSERT_TRUE(stream_->send(request)); }
  /// The next answer; fails the test after a while.
  control::Reply receive() {
    control::Reply reply;
    const auto end = std::chrono::steady_clock::now() + 40s;
    while (!stream_->next(reply)) {
      if (!stream_->wait_readable(end) || !stream_->receive()) throw std::runtime_error("no answer");
    }
    if (reply.has_failure()) throw std::runtime_error(reply.failure().what());
    return reply;
  }
  void send_burst(std::int64_t values) {
    auto change = request();
    auto& set = *change.mutable_transact()->add_changes()->mutable_set();
    set.set_instance("gauge");
    for (const auto& [name, value] : {std::pair<const char*, std::int64_t>{"burst", values}, {"go", static_cast<std::int64_t>(sent_)}}) {
      auto& argument = *set.add_parameters();
      argument.set_name(name);
      argument.mutable_value()->set_integer(value);
    }
    send(change);
  }

  const conformance::TemporaryDirectory directory_;
  ControlServer server_;
  int lifeline_[2] = {-1, -1};
  std::thread serving_;
  std::unique_ptr<os::MessageStream> stream_;
  std::uint64_t sent_ = 0;
};

TEST_P(SlowWatcher, LosesValuesCountedAndNotTheNewest) {
  constexpr std::int64_t kBurst = 20'000;
  constexpr int kBursts = 4;
  constexpr std::int64_t kLast = 77;
  auto change = request();
  auto& load = *change.mutable_transact()->add_changes()->mutable_load();
  load.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/gauge");
  load.set_group(GetParam());
  send(change);
  receive();
  auto watch = request();
  watch.mutable_watch()->mutable_port()->set_instance("gauge");
  watch.mutable_watch()->mutable_port()->set_port("count");
  send(watch);
  for (int i = 0; i < kBursts; ++i) send_burst(kBurst);
  send_burst(kLast);
  std::uint64_t accounted = 0;
  std::uint64_t samples = 0;
  control::Sample last;
  while (last.sequence() < kBursts * kBurst + kLast) {
    const auto reply = receive();
    if (!reply.has_sample()) continue;
    last = reply.sample();
    accounted += 1 + last.skipped();
    ++samples;
    ASSERT_EQ(accounted, last.sequence());
  }
  probe::Integer value;
  ASSERT_TRUE(value.ParseFromString(last.object()));
  EXPECT_EQ(value.value(), kLast);
  EXPECT_LT(samples, accounted) << "nothing was lost: the watcher was not slow";
}

using WatcherThatGoes = SlowWatcher;

TEST_P(WatcherThatGoes, DoesNotHoldUpTheHostThoughTheGroupThatItWatchedHangs) {
  auto change = request();
  auto& load = *change.mutable_transact()->add_changes()->mutable_load();
  load.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/gauge");
  load.set_group(GetParam());
  send(change);
  receive();
  auto watch = request();
  watch.mutable_watch()->mutable_port()->set_instance("gauge");
  watch.mutable_watch()->mutable_port()->set_port("level");
  send(watch);
  auto look = request();
  look.mutable_snapshot();
  send(look);
  control::Reply reply;
  while (!(reply = receive()).has_system()) continue;
  const auto& system = reply.system();
  const auto group = std::find_if(system.groups().begin(), system.groups().end(),
                                  [](const auto& one) { return one.name() == GetParam(); });
  ASSERT_NE(group, system.groups().end());
  const pid_t hangs = group->process();
  ASSERT_EQ(::kill(hangs, SIGSTOP), 0);
  stream_.reset();
  connect();
  const auto begun = std::chrono::steady_clock::now();
  auto ask = request();
  ask.mutable_journal();
  send(ask);
  EXPECT_TRUE(receive().has_journal());
  EXPECT_LT(std::chrono::steady_clock::now() - begun, 5s);
  EXPECT_EQ(::kill(hangs, SIGCONT), 0);
}

INSTANTIATE_TEST_SUITE_P(In, WatcherThatGoes, testing::Values("far"), [](const auto& one) { return one.param; });
INSTANTIATE_TEST_SUITE_P(In, SlowWatcher, testing::Values("main", "far"), [](const auto& one) { return one.param; });

}  // namespace
}  // namespace fiona::host
