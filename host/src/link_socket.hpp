#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "fiona/control.pb.h"
#include "fiona/message.hpp"
#include "fiona/pool.hpp"
#include "link_keys.hpp"
#include "link_lanes.hpp"
#include "link_message.hpp"

namespace fiona::host {

/// What the links of a process have carried and refused; written by any thread.
struct LinkCounters {
  std::atomic<std::uint64_t> sent_messages{0};
  std::atomic<std::uint64_t> sent_bytes{0};
  std::atomic<std::uint64_t> received_messages{0};
  std::atomic<std::uint64_t> received_bytes{0};
  std::atomic<std::uint64_t> garbled{0};
  std::atomic<std::uint64_t> unproven{0};
  std::atomic<std::uint64_t> not_granted{0};
  std::atomic<std::uint64_t> too_large{0};
  std::atomic<std::uint64_t> overrun{0};
  std::atomic<std::uint64_t> memory_bytes{0};
  std::atomic<std::uint64_t> late{0};

  control::LinkStatus status() const;
};

/// Frames so far between this process and another, each one that crosses once, credit and proofs aside.
struct FrameCounts {
  std::uint64_t sent = 0;      ///< on their way, or there
  std::uint64_t received = 0;  ///< whole, and dealt with
};

/// One ZeroMQ socket that several threads send through, and that the pool reads when something has come. The sending
/// strand's thread sends; a pool thread receives. There is no link thread.
///
/// To each peer it has lanes, of which at most two chunks are inside ZeroMQ at a time: what comes later may still
/// overtake what waits. Nothing reaches the receiver before the peer has proved who it is, and the other way round: by
/// the key of the link, or to the socket itself, which has CURVE and an allow-list.
class LinkSocket {
 public:
  class Receiver {
   public:
    virtual ~Receiver() = default;
    /// As FrameReader::Receiver. Of a connected link the peer is empty.
    virtual std::optional<std::uint64_t> accepts(const std::string& peer, const wire::Frame& frame) = 0;
    virtual void on_frame(const std::string& peer, const wire::Frame& frame, const ObjectBytes& object) = 0;
    /// After the frames that have come together: what is kept of them is to be passed on.
    virtual void settle() {}
    /// The process at the other end of a connected link does not know the key.
    virtual void on_refused(const std::string& reason) = 0;
  };
  class Peer;
  /// A queue to one peer.
  struct Lane {
    std::shared_ptr<Peer> peer;
    std::shared_ptr<PeerLanes::Lane> lane;
  };
  static constexpr const char* kTooLarge = "the message is larger than a link carries (64 MiB)";
  using Rule = PeerLanes::Rule;
  using Wires = std::shared_ptr<const std::vector<std::uint64_t>>;
  struct Sent {
    enum class What { Ok, Full, TooLarge, Gone };
    What what = What::Ok;
    std::size_t lost = 0;  ///< older messages that had to go for it, once for each of their wires
  };

  /// `pool` outlives `context`: until that has ended ZeroMQ lets go of what was sent, and the pool is told.
  /// `on_dealt_with` (a process on a virtual clock has it): called, holding no lock, when what has come is dealt with.
  /// Then lanes have no bound and no credit: what one round sends is handed out in the next, which bounds it, and what
  /// is lost must not depend on the speed of threads. So each frame that was taken arrives, or its peer is gone.
  LinkSocket(Pool& pool, zmq::context_t& context, zmq::socket_type type, LinkCounters& counters, Receiver& receiver,
             std::function<void()> on_dealt_with = nullptr);
  ~LinkSocket();

  /// Waits for peers, whose keys follow from the process' own and their names.
  void listen(const std::string& endpoint, LinkKeys keys);
  /// Goes to the process that listens there, as `name`; `keys.own` is the link's.
  void connect(const std::string& endpoint, std::string name, LinkKeys keys);
  /// To be given CURVE, before it listens or connects.
  zmq::socket_t& socket() { return socket_; }
  /// The same where CURVE proves both sides: peers have the names that the allow-list gives their keys.
  void listen_proven(const std::string& endpoint);
  void connect_proven(const std::string& endpoint, std::string provider);
  /// Where it listens, with the port that was chosen.
  std::string endpoint() const { return endpoint_; }
  /// Stops reading and closes: after it returned the receiver is not called any more. What has been sent and has not
  /// left yet may do so for as long as `linger`.
  void stop(std::chrono::milliseconds linger = {});

  /// A new lane to a peer that has proved its key, or that is being connected to; its `peer` is null when there is
  /// none.
  Lane open_lane(const std::string& peer);
  /// [any thread] As PeerLanes::close.
  std::size_t close_lane(const Lane& lane, PeerLanes::Rest rest = PeerLanes::Rest::IsLost);
  /// [any thread] Sends a frame with an object (null: none). Never waits: the lane is bounded.
  Sent send(const Lane& lane, wire::Frame& frame, const std::shared_ptr<const Object>& object = nullptr,
            Rule rule = Rule::Control, Wires also = nullptr);
  /// [in on_frame] What has come counts as arrived, for its sender's credit, once the last copy of this goes.
  std::shared_ptr<const void> receipt();
  /// [any thread] Sends on what has come over another link. With `Rule::DropOldest` the lane bounds it; with
  /// `Rule::Control` the sender's credit does, who has it back behind `receipt`, and what exceeds that is dropped,
  /// counted. Without an object and a lane: as `tell`. Returns the messages of the lane that had to go, or this one if
  /// the peer has gone, once for each of their wires; with `Rule::Control` none.
  std::size_t forward(const Lane& lane, const std::string& peer, wire::Frame frame, const ObjectBytes& object,
                      const std::shared_ptr<const Payload>& payload, Rule rule, std::shared_ptr<const void> receipt);
  /// [any thread] Handles what waits, on this thread: for whoever must not depend on the pool's threads being free.
  void read_now();
  /// [any thread] Whether an object of so many bytes is too large for any link; counted if so.
  bool refuses(std::size_t size);
  /// [any thread] So many messages have come for a wire that has ended meanwhile.
  void count_late(std::size_t messages) { counters_.late += messages; }
  /// [any thread] A frame of no lane in particular, behind whatever the peer is being told so.
  void tell(const std::string& peer, wire::Frame& frame);
  /// The name that the peer has proved; empty: none.
  std::string process_of(const std::string& peer);
  /// The process is gone: whatever waits for it goes.
  void forget(const std::string& process);
  /// Of a process on a virtual clock: by the name that the peer has proved; of a connected link, empty.
  std::map<std::string, FrameCounts> frame_counts();
  /// The connection is of no use: whatever waits for it goes.
  void drop(const std::string& peer);
  /// Peers that have proved their key, now.
  std::size_t peers();

 private:
  struct Gate;
  struct Debts;
  struct Debt;
  struct Release;
  struct Turn;
  struct Crossing;
  class Incoming;

  void be_proven();
  void bound_parts();
  void start();
  void take_turn();
  bool drain();
  bool receive(std::string& peer);
  void dispatch(const std::string& peer);
  void shake_hands(const std::string& peer);
  void welcome(const std::string& peer, const wire::Frame& frame);
  void check_challenge(const wire::Frame& frame);
  std::string memory_proof(const std::string& key, LinkSide side, const std::string& client_nonce,
                           const std::string& provider_nonce) const;
  void on_memory(Peer& peer, const wire::Memory& told);
  void count_received(Peer& peer);
  void pay(Peer& peer);
  void pay_locked(Peer& peer);
  std::shared_ptr<Peer> find(const std::string& peer);
  std::shared_ptr<Peer> add_peer(const std::string& identity, std::string process, bool proven);
  void forget_locked(const std::string& process);
  PeerLanes::Taken offer(Peer& peer, PeerLanes::Lane& lane, PeerLanes::Item item);
  bool joined(const Lane& lane, wire::Frame& frame, const Object& object, std::size_t size);
  void end_batch(Peer& peer);
  void send_batches();
  void pump(Peer& peer);
  bool look_again();
  bool fill(Peer& peer);
  bool send_out(Peer& peer, PeerLanes::Outgoing& out);
  bool cross(Peer& peer, Crossing crossing);
  void send_plain(const std::string& peer, const wire::Frame& frame);
  void tell_locked(Peer& peer, wire::Frame& frame);
  void tell_locked(Peer& peer, const std::optional<wire::Memory>& memory);
  PeerLanes::Item item_for(const Lane& lane, wire::Frame& frame, const std::shared_ptr<const Object>& object,
                           std::size_t size, Rule rule);
  bool has_input();

  Pool& pool_;
  LinkCounters& counters_;
  Receiver& receiver_;
  const std::function<void()> on_dealt_with_;
  const bool routed_;
  const std::string secret_;  ///< of which the nonces for unknown peers are made
  std::string endpoint_;
  LinkKeys keys_;
  std::string name_;
  std::string nonce_;
  std::mutex mutex_;        ///< the socket's, and the lanes'
  std::mutex drain_mutex_;  ///< one reader at a time keeps the order
  zmq::socket_t socket_;
  std::shared_ptr<Turn> turn_;     ///< reads, and sends what had to wait for room
  std::shared_ptr<Turn> batches_;  ///< sends what has waited for company
  std::unique_ptr<Pool::Readable> watch_;
  std::unordered_map<std::string, std::shared_ptr<Peer>> peers_;
  std::vector<zmq::message_t> parts_;    ///< the reader's
  std::shared_ptr<const void> receipt_;  ///< the reader's: of what is being handled
  Peer* sender_ = nullptr;               ///< the reader's, with what the receipt is for
  std::pair<std::uint64_t, std::size_t> arrived_;
  bool has_held_ = false;    ///< there may be peers for which ZeroMQ had no room
  bool tries_soon_ = false;  ///< what is held
  bool curve_ = false;
  std::size_t chunk_ = kLocalChunkBytes;
  bool stopped_ = false;
};

}  // namespace fiona::host
