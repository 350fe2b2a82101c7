#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "link_memory.hpp"
#include "link_socket.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {

/// ZeroMQ is given more for a peer while it holds one chunk at most, so never holds more than two; and while it holds
/// fewer messages without a chunk than this, so that small ones that come while it is busy are sent together.
inline constexpr std::size_t kMostInside_messages = 2;
/// Once it was full.
inline constexpr std::size_t kGoesOnBelow_messages = 1;
/// The room that a chunk's message has for the frames beside it.
inline constexpr std::size_t kFrameRoom = 64 * 1024;
/// Lanes whose credit is paid back together.
inline constexpr std::size_t kLanesOwed = 16;

/// A batch of so many small messages is one of a stream. To send it wakes a handful of threads one after the other, so
/// that the next one waits until it is as large as `kFullBatch`, or until the pool is told to run what is to run soon.
inline constexpr std::size_t kStream_messages = 16;
inline constexpr std::size_t kFullBatch = 80 * 1024;

/// What a link does on a thread of the pool; outlives its socket while it is queued.
struct LinkSocket::Turn final : Runnable {
  using What = void (LinkSocket::*)();
  Turn(LinkSocket& l, What w) : what(w), link(&l) {}
  void run() override {
    const std::lock_guard lock(mutex);
    if (link) (link->*what)();
  }
  void end() {
    const std::lock_guard lock(mutex);
    link = nullptr;
  }
  const What what;
  std::mutex mutex;
  LinkSocket* link;
};

/// What of a peer's is inside ZeroMQ. ZeroMQ tells from its own thread what it has let go of.
struct LinkSocket::Gate {
  Gate(Pool& p, std::shared_ptr<Turn> t, std::size_t c) : pool(p), turn(std::move(t)), chunk(c) {}
  bool has_room(std::size_t most) const { return messages < most && bytes <= chunk + kFrameRoom; }
  /// Whether more may go in; if not, the turn comes when enough has left.
  bool enter_or_wait() {
    if (!waiting && has_room(kMostInside_messages)) return true;
    waiting = true;
    return goes_on();
  }
  /// Once it was full: not for each that leaves, or it would be filled one by one.
  bool goes_on() { return has_room(kGoesOnBelow_messages) && waiting.exchange(false); }

  Pool& pool;
  const std::shared_ptr<Turn> turn;
  const std::size_t chunk;
  std::atomic<std::size_t> messages{0};  ///< those without a chunk
  std::atomic<std::size_t> bytes{0};
  std::atomic<bool> waiting{false};
};

/// What has arrived from a peer and has not been credited yet, by lane.
struct LinkSocket::Debts {
  Debts(Pool& p, std::shared_ptr<Turn> t) : pool(p), turn(std::move(t)) {}

  /// Whether it is time to pay: in portions, so that a stream of small messages does not double its traffic.
  bool add(std::uint64_t lane, std::size_t size) {
    const std::lock_guard lock(mutex);
    const auto known = std::find_if(owed.begin(), owed.end(), [lane](const auto& one) { return one.first == lane; });
    if (known != owed.end()) {
      known->second += size;
    } else {
      owed.emplace_back(lane, size);
    }
    bytes += size;
    return is_due();
  }
  bool is_due() const { return bytes >= kCreditPortion || owed.size() > kLanesOwed; }
  std::vector<std::pair<std::uint64_t, std::uint64_t>> take() {
    const std::lock_guard lock(mutex);
    bytes = 0;
    return std::exchange(owed, {});
  }
  bool due() {
    const std::lock_guard lock(mutex);
    return is_due();
  }

  Pool& pool;
  const std::shared_ptr<Turn> turn;
  std::mutex mutex;  ///< the innermost: whoever lets go of a receipt may hold another link's
  std::vector<std::pair<std::uint64_t, std::uint64_t>> owed;
  std::size_t bytes = 0;
};

/// What somebody still has of a peer's message.
struct LinkSocket::Debt {
  Debt(std::shared_ptr<Debts> d, std::uint64_t l, std::size_t b) : debts(std::move(d)), lane(l), bytes(b) {}
  Debt(const Debt&) = delete;
  Debt& operator=(const Debt&) = delete;
  ~Debt() {
    if (debts->add(lane, bytes)) debts->pool.submit(debts->turn);
  }
  const std::shared_ptr<Debts> debts;
  const std::uint64_t lane;
  const std::size_t bytes;
};

/// The bytes of one message inside ZeroMQ, and what is to be told when they have gone.
struct LinkSocket::Release {
  std::shared_ptr<Gate> gate;
  Block records;
  std::shared_ptr<const Payload> payload;
  std::size_t bytes = 0;

  static void done(void*, void* hint) {
    got_from_zmq();
    const std::unique_ptr<Release> self(static_cast<Release*>(hint));
    if (!self->gate) return;
    self->gate->bytes -= self->bytes;
    if (!self->payload) self->gate->messages -= 1;
    if (self->gate->goes_on()) self->gate->pool.submit(self->gate->turn);
  }
};

/// What goes to a peer as one: ZeroMQ takes all of its parts, or none.
struct LinkSocket::Crossing {
  void add(zmq::message_t part) { parts[count++] = std::move(part); }
  std::array<zmq::message_t, 3> parts;
  std::size_t count = 0;
  std::size_t bytes = 0;  ///< those that go through memory among them
};

class LinkSocket::Peer {
 public:
  Peer(std::string i, std::string p, std::shared_ptr<Gate> g, std::shared_ptr<Debts> d, bool has_proved)
      : identity(std::move(i)),
        process(std::move(p)),
        gate(std::move(g)),
        debts(std::move(d)),
        proven(has_proved),
        control(lanes.open()),
        reader(gate->chunk) {}

  const std::string identity;
  const std::string process;
  const std::shared_ptr<Gate> gate;
  const std::shared_ptr<Debts> debts;
  bool proven;
  std::atomic<bool> gone{false};  ///< written under the link's mutex
  FrameCounts counts;
  PeerLanes lanes;
  /// The small messages of pushes that have come since the last ones left.
  struct Batch {
    /// One more: whether it waits for company, as long as nothing else follows.
    bool waits_with(std::size_t record_size) {
      ++messages;
      bytes += record_size;
      return may_wait && bytes < kFullBatch;
    }
    std::size_t messages = 0;
    std::size_t bytes = 0;
    bool may_wait = false;  ///< it follows another one of a stream, and will leave soon
  } batch;
  std::optional<Crossing> held;  ///< ahead of the lanes: ZeroMQ has had no room for it
  const std::shared_ptr<PeerLanes::Lane> control;
  FrameReader reader;                ///< the reader's
  std::optional<LinkMemory> memory;  ///< once both have proved to know the memory key
};

}  // namespace fiona::host
