// A led host that is busy, loses its leader, or says what is not so.
#include <signal.h>

#include <array>
#include <atomic>
#include <cstring>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "fiona/trust/host_keys.hpp"
#include "hosts_fixture.hpp"
#include "link_message.hpp"
#include "os/unix_socket.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {
namespace {

/// A host that is led, in the test's own process: what it does when is the test's to say.
class HostInTheTest : public Hosts {
 protected:
  HostInTheTest() {
    keys.make();
    os::require_private_directory(directory.path / "far");
    far = std::make_unique<System>(
        System::Options{.name = "far",
                        .store = directory.path / "far" / "store",
                        .directory = directory.path / "far",
                        .threads = 2,
                        .hosts = {keys.path(), "tcp://127.0.0.1:0", {}},
                        .plugins = std::filesystem::path(TEST_COMPONENTS_LIBRARY).parent_path(),
                        .ends_hung_groups = false,
                        .restarts_groups = false,
                        .tries_libraries = false},
        [](const wire::GroupMessage&) {});
    const trust::KeyDirectory own(directory.path / "test");
    own.make();
    keys.allow("test", own.pair().open.text());
    const std::string address = far->listens().substr(std::string("tcp://").size());
    leader = std::make_unique<RunningSystem>(
        HostOptions{own.path(), "", {PeerAddress::from_text("far=" + address + "=" + keys.pair().open.text())}});
    serve_far_while([&] {
      leader->join("far");
      for (const std::string name : {"a", "b", "c"}) leader->load_in("far/deep", "sink", name);
    });
    group = far->child_groups().front()->process();
  }
  void serve_far_while(const std::function<void()>& work) {
    std::atomic<bool> done{false};
    std::thread working([&] {
      work();
      done = true;
    });
    while (!done) {
      far->serve_hosts();
      for (auto* one : far->child_groups()) far->serve_group(*one);
      std::this_thread::sleep_for(1ms);
    }
    working.join();
  }
  /// `also`: what it does beside hearing its leader.
  void expect_it_becomes_empty(const std::function<void()>& also = [] {}) {
    const auto begin = Steady::now();
    while (!far->model().names().empty() && ms_since(begin) < 30'000) {
      far->serve_hosts();
      also();
      std::this_thread::sleep_for(1ms);
    }
    EXPECT_TRUE(far->model().names().empty());
  }
  const trust::KeyDirectory keys{directory.path / "far-keys"};
  std::unique_ptr<System> far;
  std::unique_ptr<RunningSystem> leader;
  pid_t group = 0;
};

TEST_F(HostInTheTest, GroupThatDiesWithItsLeaderHurtsNobodyElse) {
  leader.reset();
  ::kill(group, SIGKILL);
  expect_it_becomes_empty();  // which finds the end of the group by itself
}

TEST_F(HostInTheTest, WhatDoesNotEndWithItsLeaderEndsLater) {
  ::kill(group, SIGSTOP);
  leader.reset();
  const auto begin = Steady::now();
  testing::internal::CaptureStderr();
  std::string said;
  while (said.empty() && ms_since(begin) < 30'000) {
    far->serve_hosts();
    said = testing::internal::GetCapturedStderr();
    testing::internal::CaptureStderr();
  }
  testing::internal::GetCapturedStderr();
  EXPECT_THAT(said, HasSubstr("a: "));
  EXPECT_THAT(said, HasSubstr("group 'deep' does not answer"));
  EXPECT_THAT(said, Not(HasSubstr("b: "))) << "it is not waited for again";
  ::kill(group, SIGCONT);
  expect_it_becomes_empty([&] { far->watch_groups(); });
}

/// By hand: it does what it is asked for, and may fall silent, or be held up.
class HostByHand {
 public:
  explicit HostByHand(const std::filesystem::path& directory)
      : keys_(directory / "by-hand"), socket_(context_, zmq::socket_type::router) {
    keys_.make();
    socket_.set(zmq::sockopt::linger, 0);
    socket_.set(zmq::sockopt::curve_server, true);
    socket_.set(zmq::sockopt::curve_secretkey, keys_.pair().secret.bytes());
    socket_.bind("tcp://127.0.0.1:*");
    address_ = socket_.get(zmq::sockopt::last_endpoint);
    thread_ = std::thread([this] { serve(); });
  }
  ~HostByHand() {
    ends_ = true;
    thread_.join();
  }
  HostOptions led_from(const std::filesystem::path& keys) const {
    trust::KeyDirectory(keys).make();
    return {keys, "", {{"far", address_, keys_.pair().open}}};
  }

  /// Events, as from what it has.
  void tell(std::vector<wire::GroupMessage> events) {
    const std::lock_guard lock(mutex_);
    events_ = std::move(events);
  }

  /// What it was asked to set last.
  wire::SetParameters set() {
    const std::lock_guard lock(mutex_);
    return set_;
  }

  std::size_t open_taps() {
    const std::lock_guard lock(mutex_);
    return taps_.size();
  }

  std::atomic<bool> is_silent{false};
  std::atomic<bool> is_busy{false};     ///< it does nothing of what it is asked for until it is not
  std::atomic<bool> is_held_up{false};  ///< until it has been asked for its status, and has not answered

 private:
  void serve() {
    while (!ends_) {
      std::array<zmq::pollitem_t, 1> waits{{{socket_.handle(), 0, ZMQ_POLLIN, 0}}};
      zmq::poll(waits, 50ms);
      for (zmq::message_t identity, record; received(socket_, identity) && received(socket_, record);) {
        if (!is_silent) hear(identity.to_string(), record.to_string());
      }
      for (; !is_busy && !asked_.empty(); asked_.pop_front()) obey(asked_.front());
      wire::HostFrame frame;
      frame.mutable_beat();
      if (!is_silent) say(frame);
      const std::lock_guard lock(mutex_);
      for (const auto& event : std::exchange(events_, {})) {
        *frame.mutable_message() = event;
        say(frame);
      }
    }
  }
  void hear(const std::string& who, std::string_view records) {
    while (records.size() >= kRecordHead) {
      const auto length = [&](std::size_t at) {
        std::uint32_t bytes = 0;
        std::memcpy(&bytes, records.data() + at, sizeof bytes);
        return bytes;
      };
      const std::size_t frame_size = length(0);
      const std::size_t object_size = length(4);
      wire::Frame frame;
      frame.ParseFromArray(records.data() + kRecordHead, static_cast<int>(frame_size));
      wire::HostFrame host = frame.host();
      if (object_size > 0)
        host.ParseFromArray(records.data() + kRecordHead + frame_size, static_cast<int>(object_size));
      records.remove_prefix(kRecordHead + frame_size + object_size);
      if (host.has_hello()) welcome(who);
      if (host.has_request()) asked_.push_back(host.request().request());
    }
  }
  void welcome(const std::string& who) {
    leader_ = who;
    wire::HostFrame frame;
    frame.mutable_welcome()->set_run(1);
    say(frame);
  }
  void obey(const wire::GroupRequest& request) {
    const std::lock_guard lock(mutex_);
    if (request.has_create()) instances_.insert(request.create().instance());
    if (request.has_set_parameters()) set_ = request.set_parameters();
    if (request.has_tap()) taps_.insert(request.tap().tap());
    if (request.has_untap()) taps_.erase(request.untap().tap());
    wire::HostFrame frame;
    auto& reply = *frame.mutable_message();
    reply.set_id(request.id());
    reply.mutable_done();
    if (request.has_status() || request.has_inventory()) {
      if (is_held_up.exchange(false)) return;
      auto& status = request.has_status() ? *reply.mutable_status() : *reply.mutable_adopted()->mutable_status();
      for (const auto& name : instances_) {
        auto& one = *status.add_instances();
        if (set_.instance() == name) *one.mutable_set_parameters() = set_.parameters();
        one.set_name(name);
        one.set_mode("active");
      }
    }
    say(frame);
  }
  void say(const wire::HostFrame& what) {
    wire::Frame frame;
    *frame.mutable_host() = what;
    const Block record = make_record(frame, nullptr, 0);
    sent(socket_, zmq::buffer(leader_), zmq::send_flags::sndmore);
    sent(socket_, zmq::buffer(record.data(), record.size()));
  }

  trust::KeyDirectory keys_;
  zmq::context_t context_;
  zmq::socket_t socket_;
  std::string address_;
  std::string leader_;
  std::deque<wire::GroupRequest> asked_;
  std::set<std::string> instances_;
  wire::SetParameters set_;
  std::set<std::uint64_t> taps_;
  std::mutex mutex_;
  std::vector<wire::GroupMessage> events_;
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

TEST_F(Hosts, InstancesOfAHostThatIsBackAndHeldUpAreThereOnceItSaysSo) {
  HostByHand other(directory.path);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "sink", "sink");
  other.is_silent = true;
  system.eventually("silent", [&] { return system.host("far").state() == "silent"; });
  other.is_held_up = true;
  other.is_silent = false;
  system.eventually("it is asked what it has", [&] { return !other.is_held_up; });
  system.eventually("its instance is back", [&] { return system.instance("sink").mode() == "active"; });
}

TEST_F(Hosts, WhatALeaderHasGivenUpAndWasDoneLaterIsTakenBack) {
  HostByHand other(directory.path);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "source", "source", "period_ms=5");
  other.is_busy = true;
  EXPECT_EQ(error_of([&] { system.set("source", "period_ms=7"); }).code(), ErrorCode::Unreachable);
  other.is_busy = false;
  system.eventually("it is done", [&] { return other.set().parameters_size() > 0; });
  EXPECT_EQ(other.set().parameters(0).value().integer(), 7);
  system.eventually("it is as it was", [&] { return other.set().parameters(0).value().number() == 5; });
}

TEST_F(Hosts, LeaderLooksAfterItsOwnGroupsWhileItWaitsForAHostThatIsBusy) {
  HostByHand other(directory.path);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "source", "source");
  system.load_in("near", "sink", "sink");
  const pid_t near = system.group("near").process();
  other.is_busy = true;
  ::kill(near, SIGKILL);
  EXPECT_EQ(error_of([&] { system.set("source", "period_ms=7"); }).code(), ErrorCode::Unreachable);
  EXPECT_EQ(::kill(near, 0), -1) << "its end has been noted";
}

TEST_F(Hosts, WhatNobodyWaitsForHoldsUpNobodyWhileAHostIsBusy) {
  HostByHand other(directory.path);
  RunningSystem system(other.led_from(directory.path / "test"));
  system.join("far");
  system.load_in("far", "source", "source");
  std::vector<std::uint64_t> taps;
  for (int i = 0; i < 3; ++i) taps.push_back(system.watch("source.newest"));
  other.is_busy = true;
  const auto begin = Steady::now();
  EXPECT_EQ(error_of([&] { system.set("source", "period_ms=7"); }).code(), ErrorCode::Unreachable);
  const double waited_ms = ms_since(begin);
  const auto told = Steady::now();
  for (const auto tap : taps) system.system().untap(tap);
  EXPECT_LT(ms_since(told), waited_ms);
  EXPECT_EQ(other.open_taps(), 3U);
  other.is_busy = false;
  system.eventually("it comes to it", [&] { return other.open_taps() == 0; });
}

/// What it says of what others have.
std::vector<wire::GroupMessage> forged_events() {
  std::vector<wire::GroupMessage> events(8);
  events[0].mutable_mode_changed()->set_instance("source");
  events[0].mutable_mode_changed()->set_mode("failed");
  events[1].mutable_run_ended()->set_instance("source");
  events[2].mutable_logged()->set_instance("source");
  events[3].mutable_asked()->set_instance("source");
  events[4].mutable_tapped()->set_tap(1);
  events[5].mutable_tap_ended()->set_tap(1);
  events[6].mutable_wire_lost()->set_wire(1);
  events[7].mutable_mode_set()->set_change(1);
  events.emplace_back().mutable_call_ended()->set_run(1);
  return events;
}

TEST_F(Hosts, HostThatIsLedIsBelievedOfWhatItHasAndOfNothingElse) {
  HostByHand other(directory.path);
  std::mutex mutex;
  std::vector<wire::GroupMessage> heard;
  os::require_private_directory(directory.path / "leader");
  System leader({.name = "leader",
                 .store = directory.path / "leader" / "store",
                 .directory = directory.path / "leader",
                 .threads = 2,
                 .hosts = other.led_from(directory.path / "test"),
                 .restarts_groups = false,
                 .tries_libraries = false},
                [&](const wire::GroupMessage& event) {
                  const std::lock_guard lock(mutex);
                  heard.push_back(event);
                });
  const auto eventually = [&](const auto& fits) {
    const auto begin = Steady::now();
    while (!fits() && ms_since(begin) < 20'000) {
      leader.serve_hosts();
      std::this_thread::sleep_for(1ms);
    }
    EXPECT_TRUE(fits());
  };
  const auto load = [&](const std::string& component, const std::string& group) {
    control::Change change;
    change.mutable_load()->set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/" + component);
    change.mutable_load()->set_instance(component);
    change.mutable_load()->set_group(group);
    change.mutable_load()->set_mode("neutral");
    leader.perform(change);
  };
  eventually([&] { return leader.snapshot().hosts(0).state() == "joined"; });
  load("source", "");
  load("sink", "far");
  control::Watch watch;
  *watch.mutable_port() = conformance::port_name("source.newest");
  leader.tap(leader.new_tap(), watch);
  {
    const std::lock_guard lock(mutex);
    heard.clear();
  }
  testing::internal::CaptureStderr();
  auto events = forged_events();
  events.emplace_back().mutable_logged()->set_instance("sink");
  other.tell(events);
  std::vector<wire::GroupMessage> believed;
  eventually([&] {
    const std::lock_guard lock(mutex);
    for (auto& event : std::exchange(heard, {})) believed.push_back(std::move(event));
    return !believed.empty() && believed.back().logged().instance() == "sink";
  });
  EXPECT_EQ(believed.size(), 1U) << believed.front().ShortDebugString();
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr("host 'far' has spoken of what it does not have, and was not asked for (mode_changed): "
                        "that is not believed; so far: 1"));
}

}  // namespace
}  // namespace fiona::host
