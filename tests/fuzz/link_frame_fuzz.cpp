// Messages of links between processes: whatever a peer sends over a real link, before and after it has proved its key,
// the ends of its wires get only objects that keep their rules, each request ends exactly once, and no wire opens
// without its token.
#include <google/protobuf/stubs/logging.h>
#include <unistd.h>

#include <algorithm>
#include <condition_variable>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "fiona/component.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/rules.hpp"
#include "fiona/testing/bench.hpp"
#include "link_keys.hpp"
#include "links.hpp"
#include "raw_peer.hpp"
#include "uninterrupted.hpp"

namespace {

using fiona::host::LinkCounters;
using fiona::host::Links;
using fiona::host::LinkSocket;
using fiona::host::ObjectBytes;
using fiona::host::RemoteWire;
using fiona::localisation::CommLocation;
using fiona::navigation::CommCoordConv;
using fiona::navigation::CommCoordConvRequest;
using fiona::wire::Frame;

constexpr const char* kPeer = "peer";
constexpr std::uint64_t kLastFrame = UINT64_MAX;  // names no wire: it says that all before it has been read
constexpr std::size_t kMostMessages = 64;
const std::string kKey(fiona::host::kKeyBytes, 'k');

/// As Links accepts an object in chunks: for the first of its wires that is the peer's.
template <class IsOwn>
std::optional<std::uint64_t> accepted_for(const Frame& frame, IsOwn is_own) {
  if (is_own(frame.wire())) return frame.wire();
  const auto other = std::find_if(frame.also().begin(), frame.also().end(), is_own);
  return other == frame.also().end() ? std::nullopt : std::optional<std::uint64_t>(*other);
}

using fiona::host::RawPeer;
/// A message of one part or of two.
using Message = RawPeer::Message;

class Ends final : public fiona::Component {
 public:
  using Component::Component;

 private:
  void on_location(const CommLocation& location) {
    if (rules_.first_violation(location)) std::abort();
  }
  CommCoordConv convert(const CommCoordConvRequest& request) {
    CommCoordConv answer;
    answer.set_map_name(request.map_name());
    return answer;
  }

  const fiona::ObjectRules rules_{*CommLocation::descriptor()};
  fiona::Requires<fiona::localisation::LocationProvider> location_{*this, "location", &Ends::on_location};
  fiona::Provides<fiona::navigation::CoordinateConversion> conversion_{*this, "conversion", &Ends::convert};
  fiona::Requires<fiona::navigation::CoordinateConversion> asked_{*this, "asked"};
  fiona::Provides<fiona::localisation::LocationProvider> told_{*this, "told"};
};

struct CountedReply final : fiona::ReplySink {
  void answer(fiona::Outcome outcome, std::string, std::shared_ptr<const fiona::Object> object) override {
    if (++answers > 1 || (outcome == fiona::Outcome::Ok) != (object != nullptr)) std::abort();
  }
  int answers = 0;
};

/// Wires' ends behind a link of their own; the peer is in this process.
class EndsAndPeer final : public LinkSocket::Receiver {
 public:
  EndsAndPeer() {
    bench_.start();
    link_->listen("inproc://fuzz", {kKey});
    peer_.emplace(context_, "inproc://fuzz", kPeer);
    peer_->prove(kKey);
    while (link_->peers() == 0) std::this_thread::yield();
  }
  ~EndsAndPeer() override { link_->stop(); }

  void run(const std::vector<Message>& messages) {
    open_wires();
    for (const auto& message : messages) peer_->send(message);
    Frame last;
    last.set_wire(kLastFrame);
    peer_->send(last);
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return all_read_; });
    }
    bench_.advance(std::chrono::milliseconds(1));
    close_wires();
    peer_->read_away();
  }

 private:
  void open_wires() {
    const std::lock_guard lock(mutex_);
    all_read_ = false;
    std::uint64_t number = 0;
    for (const char* name : {"location", "conversion", "asked"}) {
      wires_.push_back(std::make_shared<RemoteWire>(link_, kPeer, ++number, *bench_.hull().find_port(name), name));
      wires_.back()->admit();
    }
    for (int i = 0; i < 2; ++i) {
      replies_.push_back(std::make_shared<CountedReply>());
      wires_.back()->deliver({{std::make_shared<CommCoordConvRequest>(), 0, {}, 0}, replies_.back()});
    }
  }

  void close_wires() {
    for (const auto& wire : wires_) wire->cut("the test ends");
    for (const auto& reply : replies_) {
      if (reply->answers != 1) std::abort();
    }
    const std::lock_guard lock(mutex_);
    wires_.clear();
    replies_.clear();
  }

  std::optional<std::uint64_t> accepts(const std::string&, const Frame& frame) override {
    return accepted_for(frame, [](std::uint64_t wire) { return wire >= 1 && wire <= 3; });
  }
  void on_frame(const std::string&, const Frame& frame, const ObjectBytes& object) override {
    const std::lock_guard lock(mutex_);
    if (frame.wire() == kLastFrame) {
      all_read_ = true;
      changed_.notify_one();
    } else if (frame.wire() >= 1 && frame.wire() <= wires_.size()) {
      wires_[frame.wire() - 1]->on_frame(frame, object);
    }
  }
  void on_refused(const std::string&) override {}

  std::mutex mutex_;
  std::condition_variable changed_;
  bool all_read_ = false;
  std::vector<std::shared_ptr<RemoteWire>> wires_;
  std::vector<std::shared_ptr<CountedReply>> replies_;
  fiona::testing::Bench<Ends> bench_;
  fiona::Pool pool_{2};
  zmq::context_t context_;
  LinkCounters counters_;
  const std::shared_ptr<LinkSocket> link_ =
      std::make_shared<LinkSocket>(pool_, context_, zmq::socket_type::router, counters_, *this);
  std::optional<RawPeer> peer_;
};

/// All links of a process, with two wires granted that the messages may open; one peer has proved its key, another one
/// never does.
class LinksAndPeers {
 public:
  LinksAndPeers() {
    bench_.start();
    peer_.prove(kKey);
    expect(2);
    while (links_.status().peers() == 0) std::this_thread::yield();
  }
  ~LinksAndPeers() {
    links_.stop();
    std::filesystem::remove(path_);
  }

  void run(const std::vector<Message>& messages) {
    provide(1, "conversion");
    provide(2, "told");
    for (const auto& message : messages) {
      peer_.send(message);
      stranger_.send(message);
    }
    expect(2 * messages.size());
    strangers_ += messages.size();
    // Whatever a stranger sends, it stays one: at most each of its messages is counted.
    if (links_.status().peers() != 1 || links_.status().unproven() > strangers_) std::abort();
    for (const std::uint64_t wire : {1, 2}) links_.cut(wire, "the test ends");
    peer_.read_away();
    stranger_.read_away();
  }

 private:
  void provide(std::uint64_t wire, const char* port) {
    auto& provider = dynamic_cast<fiona::ProvidedPort&>(*bench_.hull().find_port(port));
    links_.provide(wire, "0123456789abcdef", kPeer, provider, 1, "client");
  }
  void expect(std::size_t messages) {
    expected_ += messages;
    while (links_.status().received_messages() < expected_) std::this_thread::yield();
  }

  const std::filesystem::path path_ =
      std::filesystem::temp_directory_path() / ("fiona-fuzz-" + std::to_string(::getpid()) + ".ipc");
  std::uint64_t expected_ = 0;
  std::uint64_t strangers_ = 0;  ///< messages of a stranger's so far: each is counted a moment after it was received
  fiona::testing::Bench<Ends> bench_;
  fiona::Pool pool_{2};
  zmq::context_t context_;
  fiona::SystemClock clock_;
  Links links_{pool_, clock_, "ipc://" + path_.string(), {kKey}, [](std::uint64_t, const std::string&) {}};
  RawPeer peer_{context_, "ipc://" + path_.string(), kPeer};
  RawPeer stranger_{context_, "ipc://" + path_.string(), "stranger"};
};

/// A process that has connected to one which sends what it likes, and may have proved the key before.
class ClientAndProvider final : public LinkSocket::Receiver {
 public:
  ClientAndProvider(const std::string& endpoint, bool knows_key) : knows_key_(knows_key) {
    provider_.set(zmq::sockopt::linger, 0);
    provider_.bind(endpoint);
    link_->connect(endpoint, kPeer, {fiona::host::link_key(kKey, kPeer)});
    challenge(hello_nonce());
    while (knows_key_ && link_->peers() == 0) std::this_thread::yield();
  }
  ~ClientAndProvider() override { link_->stop(); }

  void run(const std::vector<Message>& messages) {
    for (const auto& message : messages) send(message);
    while (counters_.received_messages < expected_) std::this_thread::yield();
    if ((link_->peers() == 1) != knows_key_) std::abort();
    for (zmq::message_t answer; fiona::host::received(provider_, answer);) continue;
  }

 private:
  std::string hello_nonce() {
    struct First final : fiona::host::FrameReader::Receiver {
      std::optional<std::uint64_t> accepts(const Frame&) override { return std::nullopt; }
      void on_frame(const Frame& one, const ObjectBytes&) override { frame = one; }
      Frame frame;
    } first;
    static_cast<void>(provider_.recv(client_));
    std::vector<zmq::message_t> parts(1);
    static_cast<void>(provider_.recv(parts.front()));
    fiona::host::FrameReader().read(parts, first);
    return first.frame.hello().nonce();
  }
  void challenge(const std::string& theirs) {
    using namespace fiona::host;
    const std::string ours(kNonceBytes, 'o');
    Frame frame;
    frame.mutable_challenge()->set_nonce(ours);
    frame.mutable_challenge()->set_proof(
        link_proof(knows_key_ ? link_key(kKey, kPeer) : kKey, LinkSide::Provider, theirs, ours));
    const Block record = make_record(frame, nullptr, 0);
    send({{reinterpret_cast<const char*>(record.data()), record.size()}});
  }
  void send(const Message& message) {
    using fiona::host::sent;
    sent(provider_, zmq::buffer(client_.to_string_view()), zmq::send_flags::sndmore);
    for (std::size_t i = 0; i < message.size(); ++i) {
      const auto more = i + 1 < message.size() ? zmq::send_flags::sndmore : zmq::send_flags::none;
      sent(provider_, zmq::buffer(message[i]), more);
    }
    ++expected_;
  }

  std::optional<std::uint64_t> accepts(const std::string&, const Frame& frame) override {
    require_key();
    return accepted_for(frame, [](std::uint64_t wire) { return wire < 3; });
  }
  void on_frame(const std::string&, const Frame&, const ObjectBytes&) override { require_key(); }
  void on_refused(const std::string&) override {}
  /// Nothing comes from who has not proved the key.
  void require_key() const {
    if (!knows_key_) std::abort();
  }

  const bool knows_key_;
  std::uint64_t expected_ = 0;
  fiona::Pool pool_{1};
  zmq::context_t context_;
  zmq::socket_t provider_{context_, zmq::socket_type::router};
  zmq::message_t client_;  ///< how the provider's socket names it
  LinkCounters counters_;
  const std::shared_ptr<LinkSocket> link_ =
      std::make_shared<LinkSocket>(pool_, context_, zmq::socket_type::dealer, counters_, *this);
};

/// Puts objects together out of chunks small enough for an input of this size to have several.
class SmallChunks final : public fiona::host::FrameReader::Receiver {
 public:
  void run(const std::vector<Message>& messages) {
    fiona::host::FrameReader reader(kSmallChunk);
    for (const auto& message : messages) {
      std::vector<zmq::message_t> parts;
      for (const auto part : message) parts.emplace_back(part.data(), part.size());
      reader.read(parts, *this);
      if (reader.unfinished() > kWires) std::abort();
    }
  }

 private:
  static constexpr std::size_t kSmallChunk = 16;
  static constexpr std::uint64_t kWires = 3;

  std::optional<std::uint64_t> accepts(const Frame& frame) override {
    return accepted_for(frame, [](std::uint64_t wire) { return wire < kWires; });
  }
  void on_frame(const Frame& frame, const ObjectBytes& object) override {
    if (frame.size() != 0 && frame.size() != object.size()) std::abort();
    if (object.size() > kSmallChunk && frame.size() > kSmallChunk && object.to_string().size() != object.size())
      std::abort();
    CommCoordConvRequest request;
    const bool whole = request.ParseFromString(object.to_string());
    if (object.parse_into(request) != whole) std::abort();
  }
};

}  // namespace

// Messages, each behind its length in two bytes; the highest bit of it says that the one behind is its second part.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto kLogBefore = google::protobuf::SetLogHandler(nullptr);  // it tells of each garbled message
  static_cast<void>(kLogBefore);
  static EndsAndPeer ends;
  static LinksAndPeers links;
  static ClientAndProvider client("inproc://provider", true);
  static ClientAndProvider deceived("inproc://impostor", false);
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  std::vector<Message> messages;
  bool second = false;
  while (rest.size() > 2 && messages.size() < kMostMessages) {
    const auto byte = [&rest](std::size_t at) { return static_cast<std::size_t>(static_cast<std::uint8_t>(rest[at])); };
    const std::size_t length = byte(0) | (byte(1) & 0x7f) << 8;
    const bool more = (byte(1) & 0x80) != 0;
    rest.remove_prefix(2);
    if (!second) messages.emplace_back();
    messages.back().push_back(rest.substr(0, length));
    rest.remove_prefix(messages.back().back().size());
    second = more && messages.back().size() < 3;
  }
  SmallChunks().run(messages);
  ends.run(messages);
  links.run(messages);
  client.run(messages);
  deceived.run(messages);
  return 0;
}
