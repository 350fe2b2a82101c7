#include "link_socket.hpp"

#include <algorithm>

namespace fiona::host {
namespace {

constexpr std::size_t kLengthBytes = 4;
/// The largest message that is read from a peer (architecture 7.5).
constexpr std::int64_t kMaxMessage = 64LL * 1024 * 1024;
/// Messages read before the pool thread serves someone else.
constexpr int kReadsPerTurn = 64;

}  // namespace

struct LinkSocket::Drain final : Runnable {
  explicit Drain(LinkSocket& l) : link(&l) {}
  void run() override {
    const std::lock_guard lock(mutex);
    if (link) link->drain();
  }
  std::mutex mutex;
  LinkSocket* link;
};

LinkSocket::LinkSocket(Pool& pool, zmq::context_t& context, zmq::socket_type type, OnFrame on_frame)
    : pool_(pool),
      on_frame_(std::move(on_frame)),
      socket_(context, type),
      drain_(std::make_shared<Drain>(*this)),
      routed_(type == zmq::socket_type::router) {
  socket_.set(zmq::sockopt::linger, 0);
  socket_.set(zmq::sockopt::sndhwm, 0);  // bounded by the wires' credit instead, which counts bytes
  socket_.set(zmq::sockopt::rcvhwm, 0);
  socket_.set(zmq::sockopt::maxmsgsize, kMaxMessage + (1 << 20));
}

LinkSocket::~LinkSocket() { stop(); }

void LinkSocket::start() {
  watch_ = pool_.watch(socket_.get(zmq::sockopt::fd), [this] { drain(); });
  pool_.submit(drain_);  // what came before the watch gives no edge
}

void LinkSocket::stop(std::chrono::milliseconds linger) {
  watch_.reset();
  {
    const std::lock_guard lock(drain_->mutex);
    drain_->link = nullptr;
  }
  const std::lock_guard lock(mutex_);
  if (!stopped_) socket_.set(zmq::sockopt::linger, static_cast<int>(linger.count()));
  stopped_ = true;
  socket_.close();
}

namespace {

/// Makes `body` with room for an object behind the frame, and returns where that begins.
std::uint8_t* begin_body(zmq::message_t& body, const wire::Frame& frame, std::size_t object_size) {
  const std::size_t frame_size = frame.ByteSizeLong();
  body.rebuild(kLengthBytes + frame_size + object_size);
  auto* out = static_cast<std::uint8_t*>(body.data());
  for (std::size_t i = 0; i < kLengthBytes; ++i) out[i] = static_cast<std::uint8_t>(frame_size >> (8 * i));
  frame.SerializeWithCachedSizesToArray(out + kLengthBytes);
  return out + kLengthBytes + frame_size;
}

}  // namespace

void LinkSocket::send(const std::string& peer, const wire::Frame& frame, const Object* object) {
  zmq::message_t body;
  auto* rest = begin_body(body, frame, object ? object->ByteSizeLong() : 0);
  if (object) object->SerializeWithCachedSizesToArray(rest);
  send_body(peer, body);
}

void LinkSocket::forward(const std::string& peer, const wire::Frame& frame, std::string_view object) {
  zmq::message_t body;
  std::copy(object.begin(), object.end(), begin_body(body, frame, object.size()));
  send_body(peer, body);
}

std::string LinkSocket::sender() const {
  const char* user = current_ ? zmq_msg_gets(const_cast<zmq_msg_t*>(current_->handle()), "User-Id") : nullptr;
  return user ? user : "";
}

void LinkSocket::send_body(const std::string& peer, zmq::message_t& body) {
  bool input = false;
  {
    const std::lock_guard lock(mutex_);
    if (stopped_) return;
    try {
      if (routed_) socket_.send(zmq::buffer(peer), zmq::send_flags::sndmore | zmq::send_flags::dontwait);
      socket_.send(body, zmq::send_flags::dontwait);
    } catch (const zmq::error_t&) {
      return;  // the peer is gone: supervision reports that, not each message
    }
    input = has_input();
  }
  // Sending may have consumed the descriptor's edge for messages that wait.
  if (input) pool_.submit(drain_);
}

bool LinkSocket::has_input() { return (socket_.get(zmq::sockopt::events) & ZMQ_POLLIN) != 0; }

void LinkSocket::drain() {
  std::unique_lock draining(drain_mutex_, std::try_to_lock);
  if (!draining) {
    draining.lock();  // the other reader may have looked already: look again after it
  }
  for (int reads = 0; reads < kReadsPerTurn; ++reads) {
    std::string peer;
    zmq::message_t body;
    {
      std::unique_lock lock(mutex_);
      if (stopped_ || !has_input() || !receive(lock, peer, body)) return;
    }
    current_ = &body;
    dispatch(peer, body);
    current_ = nullptr;
  }
  pool_.submit(drain_);
}

bool LinkSocket::receive(std::unique_lock<std::mutex>&, std::string& peer, zmq::message_t& body) {
  try {
    if (routed_) {
      zmq::message_t identity;
      if (!socket_.recv(identity, zmq::recv_flags::dontwait)) return false;
      peer = identity.to_string();
    }
    if (!socket_.recv(body, zmq::recv_flags::dontwait)) return false;
    // Further parts are not ours: read away so that the next message starts clean.
    bool foreign = false;
    for (zmq::message_t extra; socket_.get(zmq::sockopt::rcvmore);) {
      foreign = true;
      if (!socket_.recv(extra, zmq::recv_flags::dontwait)) break;
    }
    if (foreign) body.rebuild();
    return true;
  } catch (const zmq::error_t&) {
    return false;
  }
}

/// Everything from the network is checked before use: lengths, then protobuf, then the wire's own rules.
void LinkSocket::dispatch(const std::string& peer, const zmq::message_t& body) {
  if (body.size() < kLengthBytes) return;
  const auto* in = static_cast<const std::uint8_t*>(body.data());
  std::size_t frame_size = 0;
  for (std::size_t i = 0; i < kLengthBytes; ++i) frame_size |= static_cast<std::size_t>(in[i]) << (8 * i);
  if (frame_size > body.size() - kLengthBytes) return;
  wire::Frame frame;
  if (!frame.ParseFromArray(in + kLengthBytes, static_cast<int>(frame_size))) return;
  const char* object = static_cast<const char*>(body.data()) + kLengthBytes + frame_size;
  on_frame_(peer, frame, {object, body.size() - kLengthBytes - frame_size});
}

}  // namespace fiona::host
