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

#include "fan_out.hpp"
#include "fiona/port.hpp"
#include "fiona/rules.hpp"
#include "in_use.hpp"
#include "link_socket.hpp"

namespace fiona::host {

/// An object of a frame: parsed, or why it is refused.
struct ParsedObject {
  std::shared_ptr<const Object> object;
  std::optional<std::string> refusal;
  std::size_t bytes = 0;
};

/// A wire as the side sees it whose peer is in another process.
class RemoteWire : public Sink, public std::enable_shared_from_this<RemoteWire> {
 public:
  /// With a lane of its own. `name` orders deliveries in virtual time, as that of a LocalWire. `end`: of a
  /// push client.
  RemoteWire(std::shared_ptr<LinkSocket> link, std::string peer, std::uint64_t wire, Port& port, std::string name,
             std::shared_ptr<WireEnd> end = nullptr);
  /// Of a push provider: one of those that share what crosses.
  RemoteWire(std::shared_ptr<FanOut> fan_out, std::shared_ptr<LinkSocket> link, std::string peer, std::uint64_t wire,
             Port& port, std::string name, std::shared_ptr<WireEnd> end = nullptr);
  ~RemoteWire() override;

  std::uint64_t wire() const { return wire_; }
  const std::string& peer() const { return peer_; }
  const Port& port() const { return port_; }
  /// [any thread] Of the newest object that came; 0: none yet.
  std::uint64_t last_sequence() const { return last_sequence_.load(); }

  /// Tells the provider to open it. `ahead`: its grant may be under way.
  void ask(const std::string& token, bool ahead);
  /// Tells the client that it is open. Of a push provider, this also subscribes: the client is told "from sequence n"
  /// before the first message leaves.
  /// `each`: as the client says when it opens it, see FanOut::join.
  void open(std::uint32_t prescale, bool each);
  void set_prescale(std::uint32_t prescale) {
    if (fan_out_) fan_out_->set_prescale(wire_, prescale);
  }
  /// [any thread] Towards the peer.
  Outcome deliver(Parcel parcel) override;
  void lease(bool held, const std::string& reason) override;
  void attached(std::uint64_t sequence, Duration cycle) override;
  /// [any thread] From the peer. On a client's side nothing gets through before `admit`: it is kept, as much as a lane
  /// may hold.
  void on_frame(const wire::Frame& frame, const ObjectBytes& object);
  /// [any thread] A frame's object, for this wire and for others of the same port.
  ParsedObject parse_object(const ObjectBytes& object);
  void on_object(const wire::Frame& frame, const ParsedObject& object);
  /// [any thread] Whether what comes may be taken with `on_objects`: of a push client, once it is admitted.
  bool takes_many() const { return end_ && admitted_ && !clock_.staging(); }
  /// [any thread] Objects that came together, in their order, for one wait for each lock. Empties it.
  void on_objects(std::vector<Parcel>& parcels);
  void admit();
  /// [any thread] Another wire has taken the place of this one of a client: open requests end on it, and `drained` is
  /// called once there are none.
  void drain(std::function<void()> drained);
  /// [any thread] Tells the provider of a push that its wire is to end. It says so too, behind all that it has put.
  void ask_for_end(const std::string& reason);
  /// [any thread] Another wire has taken the place of this one of a push client, which did not wait for its end: what
  /// comes is lost, and counted at the port.
  void pass_over();
  /// [any thread] After it returned nothing more reaches the port but sends that have come before and wait for room.
  /// Open requests end with Disconnected. `tell`: so does the peer's end.
  void cut(const std::string& reason, bool tell = false);

 private:
  class RemoteReply;
  struct Kept {
    wire::Frame frame;
    ParsedObject object;
  };
  struct Held {
    Parcel parcel;
    std::shared_ptr<const void> receipt;  ///< its sender has no credit for it yet
  };
  Outcome deliver_locked(Parcel parcel);
  Outcome request_locked(wire::Frame& frame, Parcel parcel);
  Outcome outcome_of(const LinkSocket::Sent& sent);
  bool keep(const wire::Frame& frame, const ParsedObject& object);
  void make_room_in_kept(std::size_t cost);
  void handle_frame(const wire::Frame& frame, const ObjectBytes& object);
  void handle_object(const wire::Frame& frame, const ParsedObject& object);
  void take(const wire::Frame& frame, const ParsedObject& object);
  std::optional<Outcome> take_or_hold(Parcel parcel);
  bool has_room_for_held();
  void take_held();
  std::deque<Held> end_held();
  void note_lost(std::uint64_t messages);
  void take_in_turn(const Object* object, std::string_view word, Job job);
  std::function<void()> take_drained();
  void count_passed_over(std::size_t messages);
  void cancel(std::uint64_t id);
  void on_cancel(std::uint64_t id);
  void on_given_up(std::uint64_t id);
  void on_room(std::size_t bytes);
  void answer_room(std::size_t cost);
  void tell_room(std::size_t room);
  void on_answer(const wire::Answer& answer, const ObjectBytes& object);
  void on_fired(const wire::Fired& fired, const ObjectBytes& object);
  void forget(std::uint64_t id);
  void tell_end(const std::string& reason);
  void send_frame(wire::Frame& frame) { link_->send(lane_, frame); }

  const std::shared_ptr<LinkSocket> link_;  ///< stopped, it may be used: nothing leaves
  const std::string peer_;
  const std::uint64_t wire_;
  Port& port_;
  const std::string name_;
  Clock& clock_;
  std::atomic<std::uint64_t> staged_{0};
  const std::string room_name_;  ///< orders what is said of room in virtual time
  std::atomic<std::uint64_t> rooms_staged_{0};
  const std::shared_ptr<FanOut> fan_out_;
  const LinkSocket::Lane lane_;
  Inbox* const inbox_;                  ///< where the peer's objects go; null: none come
  const std::shared_ptr<WireEnd> end_;  ///< of a push client: through which they go there
  const ObjectRules object_rules_;
  ObjectPool objects_;
  const std::optional<ObjectRules> answer_rules_;
  ObjectPool answers_;
  std::mutex mutex_;
  bool cut_ = false;
  bool drains_ = false;  ///< takes no more: another wire has its place
  bool asked_for_end_ = false;
  bool passed_over_ = false;
  std::uint64_t told_lost_ = 0;
  std::uint32_t prescale_ = 1;
  bool each_ = false;
  std::atomic<bool> admitted_;  ///< set under the mutex
  std::deque<Kept> kept_;       ///< what came before `admit`
  std::size_t kept_bytes_ = 0;  ///< of its objects
  std::deque<Held> held_;       ///< sends that found the queue full, or others waiting there, as far as there is credit
  std::size_t held_bytes_ = 0;
  std::function<void()> drained_;
  std::unordered_map<std::uint64_t, std::shared_ptr<ReplySink>> open_;  ///< requests of ours, by id
  std::unordered_map<std::uint64_t, std::weak_ptr<ReplySink>> served_;  ///< requests of the peer's
  std::uint64_t next_id_ = 1;
  std::atomic<std::uint64_t> last_sequence_{0};
};

/// Objects of one wire that come together: its end is looked up once, and its locks are waited for once. Of one reader.
class ArrivingObjects {
 public:
  ~ArrivingObjects() { settle(); }
  /// Begins with this frame; false: the wire does not take several at once. While they are kept `use` is held.
  bool begin(const std::shared_ptr<RemoteWire>& wire, InUse& use, const wire::Frame& frame, const ObjectBytes& object);
  /// False if it is not one more object of the wire.
  bool take(const wire::Frame& frame, const ObjectBytes& object);
  /// Passes on what is kept, and lets go of the wire.
  void settle();

 private:
  void pass_on();

  std::optional<InUse::Scope> use_;
  std::shared_ptr<RemoteWire> wire_;
  std::vector<Parcel> parcels_;
};

/// An empty frame of this wire.
wire::Frame frame_for(std::uint64_t wire);

}  // namespace fiona::host
