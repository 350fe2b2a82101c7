// What a link lets in, and what it refuses and counts, seen by a peer by hand.
#include <gmock/gmock.h>
#include <google/protobuf/wrappers.pb.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "link_keys.hpp"
#include "link_memory.hpp"
#include "link_socket.hpp"
#include "raw_peer.hpp"

namespace fiona::host {
namespace {

using google::protobuf::BytesValue;
using testing::ElementsAre;

const std::string kKey(kKeyBytes, 'k');

/// Whether it came true within five seconds.
template <class F>
bool eventually(F fits) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(5);
  while (!fits()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::yield();
  }
  return true;
}

struct Noted final : LinkSocket::Receiver {
  std::optional<std::uint64_t> accepts(const std::string&, const wire::Frame& frame) override { return frame.wire(); }
  void on_frame(const std::string&, const wire::Frame& frame, const ObjectBytes& object) override {
    const std::lock_guard lock(mutex);
    wires.push_back(frame.wire());
    bytes += object.size();
    BytesValue value;
    all_x = all_x && object.parse_into(value) && value.value().find_first_not_of('x') == std::string::npos;
  }
  void on_refused(const std::string& reason) override {
    const std::lock_guard lock(mutex);
    refusal = reason;
  }
  std::vector<std::uint64_t> seen() {
    const std::lock_guard lock(mutex);
    return wires;
  }

  std::mutex mutex;
  std::vector<std::uint64_t> wires;
  std::size_t bytes = 0;
  bool all_x = true;  ///< all that the objects' values are made of
  std::string refusal;
};

class ProvingLink : public testing::Test {
 protected:
  ProvingLink() { link.listen("inproc://link", {kKey}); }
  ~ProvingLink() override { link.stop(); }

  wire::Frame frame_of(std::uint64_t wire) {
    wire::Frame frame;
    frame.set_wire(wire);
    frame.mutable_object()->set_sequence(1);
    return frame;
  }
  LinkSocket::Sent put(const LinkSocket::Lane& lane, std::uint64_t wire, std::size_t payload) {
    auto object = std::make_shared<BytesValue>();
    object->mutable_value()->assign(payload, 'x');
    wire::Frame frame = frame_of(wire);
    return link.send(lane, frame, object, LinkSocket::Rule::MustFit);
  }

  Noted noted;
  LinkCounters counters;
  Pool pool{2};
  zmq::context_t context;
  LinkSocket link{pool, context, zmq::socket_type::router, counters, noted};
};

TEST_F(ProvingLink, HearsAPeerThatKnowsTheKey) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(kKey);
  peer.send(frame_of(7));
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == 1; }));
  EXPECT_THAT(noted.seen(), ElementsAre(7));
  EXPECT_EQ(link.process_of("peer"), "peer");
}

TEST_F(ProvingLink, TheLastMessageOfAStreamWaitsForCompanyAndNotForEver) {
  Noted client_noted;
  LinkSocket client(pool, context, zmq::socket_type::dealer, counters, client_noted);
  client.connect("inproc://link", "peer", {link_key(kKey, "peer")});
  const LinkSocket::Lane lane = client.open_lane("");
  const auto push = [&] {
    wire::Frame frame = frame_of(7);
    client.send(lane, frame, std::make_shared<BytesValue>(), LinkSocket::Rule::DropOldest);
  };
  for (int i = 0; i < 40; ++i) push();  // which is a stream: they wait for the proof
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == 40; }));
  for (std::size_t i = 41; i < 50; ++i) {
    push();
    EXPECT_TRUE(eventually([&] { return noted.seen().size() == i; })) << i;
  }
  client.stop();
}

TEST_F(ProvingLink, DropsAndCountsWhatComesBeforeTheProof) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.send(frame_of(7));
  peer.send(RawPeer::Message{"nonsense"});
  EXPECT_TRUE(eventually([&] { return counters.unproven == 2; }));
  EXPECT_EQ(link.peers(), 0U);
  EXPECT_TRUE(noted.seen().empty());
}

TEST_F(ProvingLink, RefusesAProofThatWasMadeWithAnotherKey) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(std::string(kKeyBytes, 'w'));
  peer.send(frame_of(7));
  EXPECT_TRUE(eventually([&] { return counters.unproven == 2; })) << "the proof, and the frame behind it";
  EXPECT_EQ(link.peers(), 0U);
}

TEST_F(ProvingLink, TellsALinkOfAnotherVersionWhichOneItSpeaks) {
  RawPeer peer(context, "inproc://link", "peer");
  wire::Frame hello;
  hello.mutable_hello()->set_version(static_cast<wire::Version>(2));
  hello.mutable_hello()->set_client("peer");
  hello.mutable_hello()->set_nonce(std::string(kNonceBytes, 'n'));
  peer.send(hello);
  EXPECT_EQ(peer.receive().refused().reason(), "unknown protocol version: this side speaks 1");
  peer.prove(kKey);
  peer.send(frame_of(7));
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == 1; }));
}

TEST_F(ProvingLink, ClientTurnsAwayFromAProviderOfAnotherVersion) {
  const std::string endpoint = "inproc://other";
  zmq::socket_t provider(context, zmq::socket_type::router);
  provider.bind(endpoint);
  Noted client_noted;
  LinkSocket client(pool, context, zmq::socket_type::dealer, counters, client_noted);
  client.connect(endpoint, "peer", {link_key(kKey, "peer")});
  zmq::message_t identity;
  zmq::message_t hello;
  ASSERT_TRUE(provider.recv(identity) && provider.recv(hello));
  wire::Frame refused;
  refused.mutable_refused()->set_reason("unknown protocol version: this side speaks 3");
  const Block record = make_record(refused, nullptr, 0);
  provider.send(identity, zmq::send_flags::sndmore);
  provider.send(zmq::buffer(record.data(), record.size()), zmq::send_flags::none);
  EXPECT_TRUE(eventually([&] {
    const std::lock_guard lock(client_noted.mutex);
    return client_noted.refusal == "unknown protocol version: this side speaks 3";
  }));
  EXPECT_EQ(client.peers(), 0U);
  client.stop();
}

TEST_F(ProvingLink, NonceOfAnotherLengthProvesNothing) {
  RawPeer peer(context, "inproc://link", "peer");
  for (const std::size_t length : {std::size_t{0}, kNonceBytes - 1, kNonceBytes + 1}) {
    wire::Frame hello;
    hello.mutable_hello()->set_version(wire::VERSION_1);
    hello.mutable_hello()->set_client("peer");
    hello.mutable_hello()->set_nonce(std::string(length, 'n'));
    peer.send(hello);
  }
  EXPECT_TRUE(eventually([&] { return counters.unproven == 3; }));
}

TEST_F(ProvingLink, ListensToTheNewestLinkOfANameAlone) {
  RawPeer older(context, "inproc://link", "peer");
  older.prove(kKey);
  older.send(frame_of(1));
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == 1; }));
  RawPeer newer(context, "inproc://link", "peer", "another routing id");
  newer.prove(kKey);
  newer.send(frame_of(2));
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == 2; }));
  older.send(frame_of(3));
  EXPECT_TRUE(eventually([&] { return counters.unproven == 1; }));
  EXPECT_EQ(link.peers(), 1U);
  EXPECT_THAT(noted.seen(), ElementsAre(1, 2));
}

TEST_F(ProvingLink, ReadsAheadOnlySoMuchOfAPeerThatIgnoresItsCredit) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(kKey);
  const Block record = make_record(frame_of(7), nullptr, 0);
  const std::string_view message(reinterpret_cast<const char*>(record.data()), record.size());
  int sent = 0;
  {
    const std::lock_guard lock(noted.mutex);  // the reader stands
    while (sent < 10'000 && peer.try_send({message})) ++sent;
  }
  EXPECT_LT(sent, 10'000);
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == static_cast<std::size_t>(sent); }))
      << "and nothing is lost";
}

TEST_F(ProvingLink, KeyOfOneNameDoesNotProveAnother) {
  RawPeer peer(context, "inproc://link", "peer");
  wire::Frame proof;
  proof.mutable_proof()->set_client("other");
  proof.mutable_proof()->set_nonce(std::string(kNonceBytes, 'n'));
  proof.mutable_proof()->set_proof(
      link_proof(link_key(kKey, "peer"), LinkSide::Client, std::string(kNonceBytes, 'n'), ""));
  peer.send(proof);
  EXPECT_TRUE(eventually([&] { return counters.unproven == 1; }));
  EXPECT_EQ(link.peers(), 0U);
}

TEST_F(ProvingLink, ClientTurnsAwayFromAProviderThatDoesNotKnowItsKey) {
  Noted client_noted;
  LinkSocket client(pool, context, zmq::socket_type::dealer, counters, client_noted);
  client.connect("inproc://link", "peer", {link_key(std::string(kKeyBytes, 'w'), "peer")});
  EXPECT_TRUE(eventually([&] {
    const std::lock_guard lock(client_noted.mutex);
    return client_noted.refusal == "the process that listens there does not know the system's key";
  }));
  EXPECT_EQ(client.peers(), 0U);
  EXPECT_EQ(link.peers(), 0U);
  client.stop();
}

/// With what each of two knows of their host's memory, if anything.
class TwoLinks : public ProvingLink, public testing::WithParamInterface<std::pair<std::string, std::string>> {};

TEST_P(TwoLinks, CarrySmallAndLargeObjectsThroughMemoryOnlyIfBothKnowTheKeyToIt) {
  const std::string endpoint = "ipc://@fiona-link-test-" + std::to_string(::getpid());  // of no file
  LinkSocket provider(pool, context, zmq::socket_type::router, counters, noted);
  provider.listen(endpoint, {kKey, GetParam().first});
  Noted client_noted;
  LinkSocket client(pool, context, zmq::socket_type::dealer, counters, client_noted);
  client.connect(endpoint, "peer", {link_key(kKey, "peer"), GetParam().second});
  ASSERT_TRUE(eventually([&] { return client.peers() == 1; }));
  const auto lane = client.open_lane("");
  std::size_t bytes = 0;
  for (const std::size_t size : {64UL, 300'000UL, 64UL, 8'000'000UL}) {
    auto object = std::make_shared<BytesValue>();
    object->mutable_value()->assign(size, 'x');
    bytes += object->ByteSizeLong();
    wire::Frame frame = frame_of(size);
    // The largest one waits for the lane to be empty.
    EXPECT_TRUE(eventually([&] {
      return client.send(lane, frame, object, LinkSocket::Rule::MustFit).what == LinkSocket::Sent::What::Ok;
    }));
  }
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == 4; }));
  EXPECT_THAT(noted.seen(), ElementsAre(64, 300'000, 64, 8'000'000)) << "in order";
  EXPECT_EQ(noted.bytes, bytes);
  EXPECT_TRUE(noted.all_x) << "what was sent";
  const bool share = GetParam().first == GetParam().second && !GetParam().first.empty();
  const auto through_memory = [&] {
    wire::Frame frame = frame_of(1);
    auto object = std::make_shared<BytesValue>();
    object->mutable_value()->assign(kMemoryFrom, 'x');
    client.send(lane, frame, object, LinkSocket::Rule::MustFit);
    return counters.memory_bytes >= kMemoryFrom;
  };
  if (share) {
    EXPECT_TRUE(eventually(through_memory)) << "once they have told each other";
  }
  if (!share) {
    EXPECT_FALSE(through_memory());
  }
  EXPECT_EQ(counters.garbled, 0U);
  client.stop();
  provider.stop();
}

INSTANTIATE_TEST_SUITE_P(Of, TwoLinks,
                         testing::Values(std::pair("", ""), std::pair(std::string(kKeyBytes, 'm'), ""),
                                         std::pair("", std::string(kKeyBytes, 'm')),
                                         std::pair(std::string(kKeyBytes, 'm'), std::string(kKeyBytes, 'n')),
                                         std::pair(std::string(kKeyBytes, 'm'), std::string(kKeyBytes, 'm'))),
                         [](const auto& one) {
                           const auto name = [](const std::string& key) {
                             return key.empty() ? "None" : key.substr(0, 1);
                           };
                           return name(one.param.first) + name(one.param.second);
                         });

/// One who is trusted with a link to each of two processes, and not with their memory: it passes on to each what the
/// other proves.
TEST_F(ProvingLink, ProofOfTheMemoryKeyIsOfNoUseOverAnotherLink) {
  const std::string memory(kKeyBytes, 'm');
  const std::string own(kKeyBytes, 'r');
  const std::string there = "ipc://@fiona-link-test-provider-" + std::to_string(::getpid());
  const std::string here = "ipc://@fiona-link-test-relay-" + std::to_string(::getpid());
  LinkSocket provider(pool, context, zmq::socket_type::router, counters, noted);
  provider.listen(there, {kKey, memory});
  zmq::socket_t relay(context, zmq::socket_type::router);
  relay.set(zmq::sockopt::linger, 0);
  relay.set(zmq::sockopt::rcvtimeo, 5000);
  relay.bind(here);
  Noted client_noted;
  LinkCounters client_counters;
  LinkSocket client(pool, context, zmq::socket_type::dealer, client_counters, client_noted);
  client.connect(here, "peer", {link_key(own, "peer"), memory});
  RawPeer to_provider(context, there, "relay");
  zmq::message_t identity;
  const auto from_client = [&] {
    zmq::message_t message;
    EXPECT_TRUE(relay.recv(identity) && relay.recv(message));
    wire::Frame frame;
    const auto* in = static_cast<const std::uint8_t*>(message.data());
    EXPECT_TRUE(frame.ParseFromArray(in + kRecordHead, in[0] | in[1] << 8));
    return frame;
  };
  const auto to_client = [&](const wire::Frame& frame) {
    const Block record = make_record(frame, nullptr, 0);
    relay.send(identity, zmq::send_flags::sndmore);
    relay.send(zmq::buffer(record.data(), record.size()), zmq::send_flags::none);
  };

  wire::Frame hello = from_client();
  const std::string nonce = hello.hello().nonce();
  hello.mutable_hello()->set_client("relay");
  to_provider.send(hello);
  wire::Frame challenge = to_provider.receive();
  const std::string theirs = challenge.challenge().nonce();
  EXPECT_FALSE(challenge.challenge().memory_proof().empty());
  challenge.mutable_challenge()->set_proof(link_proof(link_key(own, "peer"), LinkSide::Provider, nonce, theirs));
  to_client(challenge);
  wire::Frame proof = from_client();
  EXPECT_FALSE(proof.proof().memory_proof().empty());
  proof.mutable_proof()->set_client("relay");
  proof.mutable_proof()->set_proof(link_proof(link_key(kKey, "relay"), LinkSide::Client, nonce, theirs));
  to_provider.send(proof);

  wire::Frame offer;
  offer.mutable_memory()->set_process(::getpid());
  offer.mutable_memory()->set_file_descriptor(STDERR_FILENO);
  to_provider.send(offer);
  to_client(offer);
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == 1 && client_noted.seen().size() == 1; }))
      << "both take it for a frame that no wire of theirs has";
  EXPECT_EQ(provider.peers(), 1U);
  client.stop();
  provider.stop();
}

TEST_F(ProvingLink, KeepsInOrderWhatZeroMqHasNoRoomFor) {
  constexpr std::size_t kMessages = 5'000;
  const std::string endpoint = "ipc://@fiona-link-test-full-" + std::to_string(::getpid());
  LinkSocket provider(pool, context, zmq::socket_type::router, counters, noted);
  provider.listen(endpoint, {kKey});
  Noted client_noted;
  LinkSocket client(pool, context, zmq::socket_type::dealer, counters, client_noted);
  client.socket().set(zmq::sockopt::sndhwm, 1);  // the gate lets two in
  client.connect(endpoint, "peer", {link_key(kKey, "peer")});
  const auto lane = client.open_lane("");
  for (std::size_t i = 0; i < kMessages; ++i) {
    wire::Frame frame = frame_of(i);
    client.send(lane, frame, std::make_shared<BytesValue>(), LinkSocket::Rule::Control);
  }
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == kMessages; })) << noted.seen().size();
  const auto seen = noted.seen();
  EXPECT_TRUE(std::is_sorted(seen.begin(), seen.end()));
  client.stop();
  provider.stop();
}

TEST_F(ProvingLink, HearsAllWhileItsOwnFindNoRoomInZeroMq) {
  constexpr std::size_t kBursts = 100;
  constexpr std::size_t kBurst = 6;
  const std::string endpoint = "ipc://@fiona-link-test-both-" + std::to_string(::getpid());
  LinkSocket provider(pool, context, zmq::socket_type::router, counters, noted);
  provider.socket().set(zmq::sockopt::sndhwm, 1);  // the gate lets two in
  provider.listen(endpoint, {kKey});
  Noted client_noted;
  LinkSocket client(pool, context, zmq::socket_type::dealer, counters, client_noted);
  client.socket().set(zmq::sockopt::sndhwm, 1);
  client.socket().set(zmq::sockopt::routing_id, "peer");
  client.connect(endpoint, "peer", {link_key(kKey, "peer")});
  ASSERT_TRUE(eventually([&] { return client.peers() == 1 && provider.peers() == 1; }));
  const auto object = std::make_shared<BytesValue>();
  object->mutable_value()->assign(17 * 1024, 'x');  // each crosses alone
  const auto lane = client.open_lane("");
  const auto lane_back = provider.open_lane("peer");
  const auto burst = [&](LinkSocket& from, const LinkSocket::Lane& on) {
    for (std::size_t i = 0; i < kBurst; ++i) {
      wire::Frame frame = frame_of(i);
      from.send(on, frame, object, LinkSocket::Rule::Control);
    }
  };
  for (std::size_t i = 1; i <= kBursts; ++i) {
    std::thread other([&] { burst(provider, lane_back); });
    burst(client, lane);
    other.join();
    ASSERT_TRUE(eventually([&] { return noted.seen().size() == i * kBurst; })) << i << ": " << noted.seen().size();
    ASSERT_TRUE(eventually([&] { return client_noted.seen().size() == i * kBurst; }))
        << i << ": " << client_noted.seen().size();
  }
  client.stop();
  provider.stop();
}

/// A signal every now and then for each thread but its own, as a profiler sends them.
class SignalStorm {
 public:
  SignalStorm() {
    struct sigaction action {};
    action.sa_handler = [](int) {};
    ::sigaction(SIGUSR1, &action, nullptr);
    thread_ = std::thread([this] {
      while (!ends_) {
        for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
          const pid_t one = std::stoi(task.path().filename().string());
          if (one != ::gettid()) ::syscall(SYS_tgkill, ::getpid(), one, SIGUSR1);
        }
      }
    });
  }
  ~SignalStorm() {
    ends_ = true;
    thread_.join();  // the handler stays: some are on their way
  }
  SignalStorm(const SignalStorm&) = delete;
  SignalStorm& operator=(const SignalStorm&) = delete;

 private:
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

TEST_F(ProvingLink, LosesNothingToSignalsThatInterruptItsThreads) {
  constexpr std::size_t kMessages = 20'000;
  LinkSocket client(pool, context, zmq::socket_type::dealer, counters, noted);
  client.connect("inproc://link", "peer", {link_key(kKey, "peer")});
  ASSERT_TRUE(eventually([&] { return link.peers() == 1; }));
  const auto lane = client.open_lane("");
  {
    const SignalStorm storm;
    for (std::size_t i = 0; i < kMessages; ++i) {
      wire::Frame frame = frame_of(i);
      client.send(lane, frame, std::make_shared<BytesValue>(), LinkSocket::Rule::Control);
    }
    EXPECT_TRUE(eventually([&] { return noted.seen().size() == kMessages; })) << noted.seen().size();
  }
  client.stop();
}

TEST_F(ProvingLink, HoldsTwoChunksInsideZeroMqAtMostSoThatASmallMessageComesRightBehindThem) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(kKey);
  ASSERT_TRUE(eventually([&] { return link.peers() == 1; }));
  const auto large = link.open_lane("peer");
  const auto small = link.open_lane("peer");
  put(large, 1, 8 * kLocalChunkBytes);
  const auto inside = counters.sent_messages.load();
  EXPECT_LE(inside, 2U) << "the peer has read none yet";
  put(small, 2, 64);
  std::uint64_t before = 0;
  while (peer.receive().wire() != 2) ++before;
  EXPECT_LE(before, inside + 1);
  EXPECT_GE(before, 1U);
}

TEST_F(ProvingLink, CountsWhatIsGarbledAndGoesOn) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(kKey);
  peer.send(RawPeer::Message{"nonsense"});
  peer.send(RawPeer::Message{std::string_view("\xff\xff\xff\xff\0\0\0\0", 8)});
  peer.send(RawPeer::Message{"a", "b", "c"});
  peer.send(frame_of(7));
  EXPECT_TRUE(eventually([&] { return noted.seen().size() == 1; }));
  EXPECT_EQ(counters.garbled, 3U);
}

TEST_F(ProvingLink, OwesForAnObjectThatItDropsBeforeItIsWhole) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(kKey);
  wire::Frame first = frame_of(7);
  first.set_size(2 * kLocalChunkBytes);
  first.set_lane(3);
  wire::Frame empty;
  empty.set_wire(7);
  empty.mutable_more();
  peer.send(first, "x");
  peer.send(empty);
  const wire::Frame answer = peer.receive();
  ASSERT_TRUE(answer.has_credit());
  EXPECT_THAT(answer.credit().lane(), ElementsAre(3));
  EXPECT_THAT(answer.credit().bytes(), ElementsAre(2 * kLocalChunkBytes + kFrameCost));
  EXPECT_EQ(counters.garbled, 1U);
}

TEST_F(ProvingLink, LetsGoOfAPeerThatLeavesUnreadWhatNoCreditBounds) {
  RawPeer peer(context, "inproc://link", "peer", "peer", 1);
  peer.prove(kKey);
  ASSERT_TRUE(eventually([&] { return link.peers() == 1; }));
  const auto lane = link.open_lane("peer");
  wire::Frame frame = frame_of(7);
  std::size_t told = 0;
  for (; link.peers() == 1 && told < 1'000'000; ++told) link.tell("peer", frame);
  EXPECT_EQ(counters.overrun, 1U);
  EXPECT_LT(told * kFrameCost, 2 * kMostControl);
  EXPECT_EQ(put(lane, 7, 10).what, LinkSocket::Sent::What::Gone);
  peer.send(frame);
  EXPECT_TRUE(eventually([&] { return counters.unproven == 1; })) << "it is not heard any more";
  EXPECT_THAT(noted.seen(), ElementsAre());
}

TEST_F(ProvingLink, PassesOnWhatItsSenderHasCreditForAndNoMore) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(kKey);
  ASSERT_TRUE(eventually([&] { return link.peers() == 1; }));
  const auto lane = link.open_lane("peer");
  const std::string bytes(kChunkBytes / 2, 'x');
  const auto payload = std::make_shared<const Payload>(ObjectBytes(bytes));
  wire::Frame frame = frame_of(7);
  const auto forward = [&] {
    link.forward(lane, "peer", frame, ObjectBytes(bytes), payload, LinkSocket::Rule::Control, nullptr);
  };
  forward();
  EXPECT_EQ(counters.overrun, 1U) << "an object without a lane";
  frame.set_lane(1);
  const std::size_t window = kLaneWindow / bytes.size();
  for (std::size_t i = 0; i < 2 * window; ++i) forward();
  EXPECT_EQ(counters.overrun, 1U) << "as much as it has credit for, and as it may keep itself";
  for (std::size_t i = 0; i < 3 * window; ++i) forward();
  EXPECT_GT(counters.overrun, window);
  EXPECT_EQ(link.peers(), 1U);
}

TEST_F(ProvingLink, RefusesAnObjectAboveTheCapAtTheSender) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(kKey);
  ASSERT_TRUE(eventually([&] { return link.peers() == 1; }));
  const auto sent = put(link.open_lane("peer"), 1, kMaxObject);
  EXPECT_EQ(sent.what, LinkSocket::Sent::What::TooLarge);
  EXPECT_EQ(counters.too_large, 1U);
  EXPECT_EQ(counters.sent_messages, 0U);
}

TEST_F(ProvingLink, ForgetsAProcessThatIsGone) {
  RawPeer peer(context, "inproc://link", "peer");
  peer.prove(kKey);
  ASSERT_TRUE(eventually([&] { return link.peers() == 1; }));
  link.forget("peer");
  EXPECT_EQ(link.peers(), 0U);
  EXPECT_EQ(link.open_lane("peer").peer, nullptr);
}

}  // namespace
}  // namespace fiona::host
