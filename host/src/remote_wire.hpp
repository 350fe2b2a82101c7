#pragma once

#include <atomic>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "fiona/port.hpp"
#include "fiona/rules.hpp"
#include "link_socket.hpp"

namespace fiona::host {

/// The bytes that may be on their way over one wire, and again that may wait for room (architecture 7.4).
inline constexpr std::size_t kWireWindow = 4 * 1024 * 1024;

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
  /// [any thread] Of the newest object that came; 0: none yet.
  std::uint64_t last_sequence() const { return last_sequence_.load(); }

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
  std::atomic<std::uint64_t> last_sequence_{0};
};

bool is_push(const Port& port);
/// An empty frame of this wire.
wire::Frame frame_for(std::uint64_t wire);

}  // namespace fiona::host
