// What a host and the one that leads it say to each other, whatever either of them does on the way.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "fiona/error.hpp"
#include "leader_link.hpp"
#include "links_fixture.hpp"
#include "peer_link.hpp"
#include "remote_group.hpp"
#include "uninterrupted.hpp"
#include "zap.hpp"

namespace fiona::host {
namespace {

/// A host that may be led, and what its leader says to it by hand.
class LedHost {
 public:
  using OnChange = std::function<void(const HostChange&)>;

  LedHost(const std::filesystem::path& directory, Pool& pool, Clock& clock, Links& links, zmq::context_t& context,
          OnChange on_change)
      : ours_(directory / "ours"), leaders_(directory / "leaders"), context_(context) {
    ours_.make();
    leaders_.make();
    ours_.allow("leader", leaders_.pair().open.text());
    zap_.emplace(context, Zap::hosts(ours_), [](const std::string&) {});
    around_.emplace(HostSurroundings{"led", 1, ours_.pair(), pool, clock, links, context, {}, std::move(on_change)});
    link_ = std::make_unique<LeaderLink>(*around_, ours_, "tcp://127.0.0.1:0");
    serving_ = std::thread([this] { serve(); });
  }
  ~LedHost() {
    link_->stop();
    ends_ = true;
    serving_.join();
  }
  LeaderLink& link() { return *link_; }
  /// The leader connects.
  zmq::socket_t connect() {
    zmq::socket_t socket(context_, zmq::socket_type::dealer);
    socket.set(zmq::sockopt::linger, 0);
    socket.set(zmq::sockopt::rcvtimeo, 5000);
    socket.set(zmq::sockopt::curve_serverkey, ours_.pair().open.bytes());
    socket.set(zmq::sockopt::curve_publickey, leaders_.pair().open.bytes());
    socket.set(zmq::sockopt::curve_secretkey, leaders_.pair().secret.bytes());
    socket.connect(link_->address());
    return socket;
  }
  static void say_hello(zmq::socket_t& socket, std::int64_t now_ns = 0, wire::Version version = wire::VERSION_1) {
    wire::Frame frame;
    auto& hello = *frame.mutable_host()->mutable_hello();
    hello.set_version(version);
    hello.set_run(1);
    hello.mutable_beat()->set_now_ns(now_ns);
    const Block record = make_record(frame, nullptr, 0);
    sent(socket, zmq::buffer(record.data(), record.size()));
  }

 private:
  void serve() {
    std::array<zmq::pollitem_t, 1> waits{{{zap_->socket().handle(), 0, ZMQ_POLLIN, 0}}};
    while (!ends_) {
      if (zmq::poll(waits, 10ms) > 0) zap_->serve();
    }
  }

  trust::KeyDirectory ours_;
  trust::KeyDirectory leaders_;
  zmq::context_t& context_;
  std::optional<Zap> zap_;
  std::optional<HostSurroundings> around_;
  std::unique_ptr<LeaderLink> link_;
  std::atomic<bool> ends_{false};
  std::thread serving_;
};

/// What a host says next to who leads it.
wire::HostFrame said_to(zmq::socket_t& socket) {
  zmq::message_t message;
  wire::Frame frame;
  if (!uninterrupted([&] { return socket.recv(message); })) return {};
  const auto* in = static_cast<const std::uint8_t*>(message.data());
  return frame.ParseFromArray(in + kRecordHead, in[0] | in[1] << 8) ? frame.host() : wire::HostFrame();
}

/// Stands still for those who ask from other threads than the one that it was made on.
class StandingClock final : public Clock {
 public:
  explicit StandingClock(Clock& clock) : clock_(clock) {}
  TimePoint now() const override {
    while (std::this_thread::get_id() != owner_ && !goes_on) is_asked = true;
    return clock_.now();
  }
  TimePoint start() const override { return clock_.start(); }
  TimerId schedule(TimePoint at, const std::shared_ptr<Strand>& strand, Job job) override {
    return clock_.schedule(at, strand, std::move(job));
  }
  void cancel(TimerId timer) override { clock_.cancel(timer); }
  mutable std::atomic<bool> is_asked{false};
  std::atomic<bool> goes_on{false};

 private:
  Clock& clock_;
  const std::thread::id owner_ = std::this_thread::get_id();
};

/// A host that another one leads, by hand.
class HostByHand {
 public:
  HostByHand(const std::filesystem::path& directory, zmq::context_t& context)
      : leaders_(directory / "leaders"), own_(directory / "own"), socket_(context, zmq::socket_type::router) {
    leaders_.make();
    own_.make();
    socket_.set(zmq::sockopt::linger, 0);
    socket_.set(zmq::sockopt::curve_server, true);
    socket_.set(zmq::sockopt::curve_secretkey, own_.pair().secret.bytes());
    socket_.bind("tcp://127.0.0.1:*");
  }
  PeerAddress address() const { return {"by-hand", socket_.get(zmq::sockopt::last_endpoint), own_.pair().open}; }
  trust::KeyPair leaders_keys() const { return leaders_.pair(); }
  /// Says welcome to whatever has come.
  void answer() {
    wire::HostFrame welcome;
    welcome.mutable_welcome()->set_run(2);
    zmq::message_t identity;
    while (received(socket_, identity)) {
      for (zmq::message_t rest; received(socket_, rest);) continue;
      leader_ = identity.to_string();
      say(welcome);
    }
  }
  void say(const wire::HostFrame& what) {
    wire::Frame frame;
    frame.mutable_host();
    const bool is_small = what.ByteSizeLong() <= kInlineBytes;
    if (is_small) *frame.mutable_host() = what;
    const Block record = make_record(frame, is_small ? nullptr : &what, is_small ? 0 : what.ByteSizeLong());
    sent(socket_, zmq::buffer(leader_), zmq::send_flags::sndmore);
    sent(socket_, zmq::buffer(record.data(), record.size()));
  }

 private:
  trust::KeyDirectory leaders_;
  trust::KeyDirectory own_;
  zmq::socket_t socket_;
  std::string leader_;
};

TEST_F(LinksOfAProcess, AHostHoldsNothingWhileItTellsWhoLeads) {
  LedHost* led = nullptr;
  std::future<std::string> asked;
  std::promise<bool> answered;
  LedHost host(directory.path, pool, clock, links, context, [&](const HostChange& change) {
    if (change.what != HostChange::What::Joined) return;
    asked = std::async(std::launch::async, [&] { return led->link().leader(); });
    answered.set_value(asked.wait_for(5s) == std::future_status::ready);
  });
  led = &host;
  zmq::socket_t leader = host.connect();
  LedHost::say_hello(leader);
  auto whether = answered.get_future();
  ASSERT_EQ(whether.wait_for(20s), std::future_status::ready);
  EXPECT_TRUE(whether.get());
  EXPECT_EQ(asked.get(), "leader");
}

TEST_F(LinksOfAProcess, AHelloOfAConnectionThatItsLeaderHasGivenUpTakesNothingOver) {
  std::atomic<int> changes{0};
  LedHost host(directory.path, pool, clock, links, context, [&](const HostChange&) { ++changes; });
  zmq::socket_t later = host.connect();
  LedHost::say_hello(later, 200);
  EXPECT_TRUE(said_to(later).has_welcome());
  zmq::socket_t earlier = host.connect();
  LedHost::say_hello(earlier, 100);
  LedHost::say_hello(earlier, 100, static_cast<wire::Version>(99));
  EXPECT_TRUE(said_to(earlier).has_refused()) << "and nothing before that";
  EXPECT_EQ(changes, 1) << "it was joined";
  LedHost::say_hello(earlier, 300);
  EXPECT_TRUE(said_to(earlier).has_welcome()) << "one that comes anew resumes";
}

TEST_F(LinksOfAProcess, AHostThatIsWelcomedWhileItGivesUpIsNotJoinedWithoutAConnection) {
  HostByHand other(directory.path, context);
  StandingClock standing(clock);
  std::optional<HostChange> last;
  const auto on_change = [&](HostChange change) { last = std::move(change); };
  const HostSurroundings around{"ours", 1, other.leaders_keys(), pool, standing, links, context, {}, on_change};
  PeerLink peer(around, other.address());
  EXPECT_TRUE(becomes_true([&] {
    peer.tick(std::chrono::steady_clock::now());
    other.answer();
    return standing.is_asked.load();
  }));
  auto given_up = std::async(std::launch::async, [&] { peer.tick(std::chrono::steady_clock::now() + 1h); });
  given_up.wait_for(100ms);  // it waits for who reads the welcome; where it has not come so far, there is a connection
  standing.goes_on = true;
  given_up.get();
  try {
    peer.request("main", {}, 1s);
    ADD_FAILURE() << "nobody has answered";
  } catch (const Error& error) {
    EXPECT_EQ(peer.joined(), error.text().what == "host 'by-hand' does not answer") << error.text().what;
  }
  ASSERT_TRUE(last);
  EXPECT_EQ(peer.joined(), last->what == HostChange::What::Joined);
  EXPECT_EQ(peer.joined(), last->reason.empty()) << last->reason;
  peer.stop();
}

TEST_F(LinksOfAProcess, AGroupOfAnotherHostIsAskedForItsStatusNoLongerThanThereIsPatience) {
  HostByHand other(directory.path, context);
  const auto on_change = [](const HostChange&) {};
  const HostSurroundings around{"ours", 1, other.leaders_keys(), pool, clock, links, context, {}, on_change};
  PeerLink peer(around, other.address());
  ASSERT_TRUE(becomes_true([&] {
    peer.tick(std::chrono::steady_clock::now());
    other.answer();
    return peer.joined();
  }));
  RemoteGroup group("by-hand", peer, "main", nullptr);
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_FALSE(group.status(1ms));
  EXPECT_LT(std::chrono::steady_clock::now() - begun, 1s) << "which requests have for the way";
  EXPECT_TRUE(group.silent_since());
  peer.stop();
}

TEST_F(LinksOfAProcess, AHostThatSaysMoreThanIsReadLosesItsSession) {
  HostByHand other(directory.path, context);
  std::atomic<std::size_t> heard{0};
  std::mutex mutex;
  std::string lost;
  const auto on_event = [&](const wire::GroupMessage&) { ++heard; };
  const auto on_change = [&](const HostChange& change) {
    const std::lock_guard lock(mutex);
    if (change.what == HostChange::What::Lost) lost = change.reason;
  };
  const HostSurroundings around{"ours", 1, other.leaders_keys(), pool, clock, links, context, on_event, on_change};
  PeerLink peer(around, other.address());
  const auto now_joined = [&] {
    peer.tick(std::chrono::steady_clock::now());
    other.answer();
    return peer.joined();
  };
  ASSERT_TRUE(becomes_true(now_joined));
  wire::GroupRequest create;
  create.mutable_create()->set_instance("talker");
  ASSERT_TRUE(peer.tell("main", create));
  wire::HostFrame said;
  said.mutable_message()->mutable_logged()->set_instance("talker");
  said.mutable_message()->mutable_logged()->set_text(std::string(512 * 1024, 'x'));
  constexpr std::size_t kMore = kMostUnread / (512 * 1024) + 10;
  for (std::size_t i = 1; i <= kMore; ++i) {
    other.say(said);
    ASSERT_TRUE(becomes_true([&] { return now_joined() && heard == i; })) << i;
    if (i % (kMore / 2) == 0) peer.was_read();
  }
  for (std::size_t i = 0; i < kMore; ++i) other.say(said);
  EXPECT_TRUE(becomes_true([&] {
    peer.tick(std::chrono::steady_clock::now());
    const std::lock_guard lock(mutex);
    return !lost.empty();
  }));
  EXPECT_THAT(lost, testing::StartsWith("host 'by-hand' has said more than 64 MiB"));
  EXPECT_LT((heard - kMore) * 512 * 1024, kMostUnread);
  peer.stop();
}

}  // namespace
}  // namespace fiona::host
