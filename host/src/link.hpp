#pragma once

#include <atomic>
#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <unordered_map>
#include <zmq.hpp>

#include "fiona/pool.hpp"
#include "fiona/port.hpp"
#include "fiona/rules.hpp"
#include "fiona/wire.pb.h"

namespace fiona::host {

/// The bytes that may be on their way over one wire, and again that may wait for room (architecture 7.4).
inline constexpr std::size_t kWireWindow = 4 * 1024 * 1024;

/// One ZeroMQ socket that several threads send through, and that the pool reads when something has come.
///
/// A message is [peer's identity, on a listening socket] then one part: the frame's length in 4 bytes little endian,
/// the frame, the object. The sending strand's thread sends; a pool thread receives. There is no link thread.
class LinkSocket {
 public:
  using OnFrame = std::function<void(const std::string& peer, const wire::Frame& frame, std::string_view object)>;

  LinkSocket(Pool& pool, zmq::context_t& context, zmq::socket_type type, OnFrame on_frame);
  ~LinkSocket();

  zmq::socket_t& socket() { return socket_; }
  /// Starts reading; call once the socket is bound or connected.
  void start();
  /// Stops reading and closes: after it returned `on_frame` is not called any more.
  void stop();
  /// [any thread] Sends a frame with an object (null: none). Never waits: what bounds the queue is each wire's credit.
  void send(const std::string& peer, const wire::Frame& frame, const Object* object);

 private:
  struct Drain;
  void drain();
  bool receive(std::unique_lock<std::mutex>& lock, std::string& peer, zmq::message_t& body);
  void dispatch(const std::string& peer, const zmq::message_t& body);
  bool has_input();

  Pool& pool_;
  const OnFrame on_frame_;
  std::mutex mutex_;          ///< the socket's
  std::mutex drain_mutex_;    ///< one reader at a time keeps the order
  zmq::socket_t socket_;
  std::shared_ptr<Drain> drain_;
  std::unique_ptr<Pool::Readable> watch_;
  bool stopped_ = false;
  const bool routed_;
};

/// What one side of a wire may still send: bytes sent and not yet credited, and what waits for credit.
class CreditQueue {
 public:
  struct Item {
    wire::Frame frame;
    std::shared_ptr<const Object> object;
    std::size_t bytes = 0;
  };
  using SendNow = std::function<void(const Item&)>;

  /// Sends the item now, or queues it; a full queue of a push loses its oldest, counted. False: refused, full.
  bool offer(Item item, bool drop_oldest, const SendNow& send);
  void credit(std::size_t bytes, const SendNow& send);
  std::uint64_t dropped() const { return dropped_; }

 private:
  bool may_send(std::size_t bytes) const { return in_flight_ == 0 || in_flight_ + bytes <= kWireWindow; }

  std::size_t in_flight_ = 0;
  std::size_t waiting_bytes_ = 0;
  std::deque<Item> waiting_;
  std::uint64_t dropped_ = 0;
};

/// A wire as the side sees it whose peer is in another process.
class RemoteWire : public Sink, public std::enable_shared_from_this<RemoteWire> {
 public:
  RemoteWire(LinkSocket& link, std::string peer, std::uint64_t wire, Port& port);

  std::uint64_t wire() const { return wire_; }
  const std::string& peer() const { return peer_; }
  const Port& port() const { return port_; }

  /// Subscribes by `attach`, which returns the sequence number after which messages come, and tells the peer before
  /// the first of them leaves.
  void open(const std::function<std::uint64_t()>& attach);
  /// [any thread] Towards the peer.
  Outcome deliver(Parcel parcel) override;
  void lease(bool held, const std::string& reason) override;
  /// [any thread] From the peer. On a client's side nothing gets through before `admit`: it is kept, which the credit
  /// bounds.
  void on_frame(const wire::Frame& frame, std::string_view object);
  void admit();
  /// [any thread] Another wire has taken the place of this one of a client: open requests end on it, and `drained` is
  /// called once there are none.
  void drain(std::function<void()> drained);
  /// [any thread] After it returned nothing more reaches the port. Open requests end with Disconnected.
  void cut(const std::string& reason);

 private:
  class RemoteReply;
  Outcome deliver_locked(Parcel parcel);
  void handle_frame(const wire::Frame& frame, std::string_view object);
  std::function<void()> take_drained();
  void cancel(std::uint64_t id);
  void on_object(const wire::Frame& frame, std::string_view object);
  void on_answer(const wire::Answer& answer, std::string_view object);
  void on_fired(const wire::Fired& fired, std::string_view object);
  void forget(std::uint64_t id);
  void give_credit(std::size_t bytes);
  static std::shared_ptr<Object> parse(ObjectPool& pool, std::string_view object);
  void send_frame(const wire::Frame& frame, const Object* object) { link_.send(peer_, frame, object); }
  CreditQueue::SendNow sender();

  LinkSocket& link_;
  const std::string peer_;
  const std::uint64_t wire_;
  Port& port_;
  const ObjectRules object_rules_;
  ObjectPool objects_;
  const std::optional<ObjectRules> answer_rules_;
  ObjectPool answers_;
  std::mutex mutex_;
  bool cut_ = false;
  bool opening_ = false;
  bool admitted_;
  std::vector<std::pair<wire::Frame, std::string>> kept_;  ///< what came before `admit`
  std::function<void()> drained_;
  std::vector<Parcel> early_;  ///< put while the peer is being told that the wire is open
  CreditQueue credit_;
  std::size_t owed_credit_ = 0;
  std::unordered_map<std::uint64_t, std::shared_ptr<ReplySink>> open_;  ///< requests of ours, by id
  std::unordered_map<std::uint64_t, std::weak_ptr<ReplySink>> served_;  ///< requests of the peer's
  std::uint64_t next_id_ = 1;
};

/// The links of one process: its listening endpoint and its connections to peers.
class Links {
 public:
  using OnLost = std::function<void(std::uint64_t wire, const std::string& reason)>;

  /// Listens at `endpoint` ("ipc:///run/…").
  Links(Pool& pool, std::string endpoint, OnLost on_lost);
  ~Links();

  const std::string& endpoint() const { return endpoint_; }
  /// Closes the sockets: after it returned no message reaches a port any more.
  void stop();
  /// Lets a peer open `wire` to `provider` if it brings `token`.
  void provide(std::uint64_t wire, std::string token, ProvidedPort& provider, std::uint32_t prescale);
  /// [control thread] Opens `wire` from `client` to the process that listens at `endpoint`; then calls `switch_over`,
  /// which lets go of the wire that it replaces, and lets messages through. Throws Error Unreachable when the wire is
  /// not open in time, with the peer's reason when it refuses; the client's port is then as before.
  void require(std::uint64_t wire, const std::string& token, RequiredPort& client, const std::string& provider_name,
               const std::string& endpoint, const std::function<void()>& switch_over);
  /// Ends a wire on this side and tells the peer.
  void cut(std::uint64_t wire, const std::string& reason);
  /// Another wire has taken this one's place at its client: it goes once its open requests have ended.
  void retire(std::uint64_t wire);
  /// The ports of `hull` are going: so does what is left of their wires.
  void release(const Hull& hull);
  /// The process behind `endpoint` is gone: its wires are lost.
  void peer_lost(const std::string& endpoint, const std::string& reason);

 private:
  struct Grant {
    std::string token;
    ProvidedPort* provider = nullptr;
    std::uint32_t prescale = 1;
    std::shared_ptr<RemoteWire> wire;  ///< once opened
    std::shared_ptr<Sink> sink;        ///< what the provider puts into: the wire, behind a prescale
  };
  struct Requirement {
    RequiredPort* client = nullptr;
    std::string endpoint;
    std::string provider_name;
    std::shared_ptr<RemoteWire> wire;
    std::optional<std::string> refusal;  ///< once the peer has answered; empty: open
    bool retired = false;
  };
  struct Peer {
    std::unique_ptr<LinkSocket> link;
  };

  void on_server_frame(const std::string& peer, const wire::Frame& frame, std::string_view object);
  void on_client_frame(const wire::Frame& frame, std::string_view object);
  void open_for(const std::string& peer, const wire::Frame& frame);
  void refuse(const std::string& peer, std::uint64_t wire, const std::string& reason);
  void note_answer(std::uint64_t wire, const std::string& refusal);
  void end(std::uint64_t wire, const Grant& grant, const std::string& reason);
  void end(std::uint64_t wire, const Requirement& requirement, const std::string& reason);
  LinkSocket& connect(const std::string& endpoint);

  Pool& pool_;
  zmq::context_t context_;
  const std::string endpoint_;
  const OnLost on_lost_;
  std::mutex mutex_;
  std::condition_variable answered_;  ///< a requirement has its answer
  std::map<std::uint64_t, Grant> grants_;
  std::map<std::uint64_t, Requirement> requirements_;
  std::map<std::string, Peer> peers_;
  std::unique_ptr<LinkSocket> server_;
};

}  // namespace fiona::host
