#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>

#include "link_message.hpp"

namespace fiona::host {

/// The bytes that may be on their way over one lane, and again that may wait for room (docs/architecture.md, The way of
/// a message).
inline constexpr std::size_t kLaneWindow = 4 * 1024 * 1024;
/// A receiver gives credit back once it owes this much, so that less of a lane may stay without credit for ever.
inline constexpr std::size_t kCreditPortion = kLaneWindow / 8;
/// Small messages that wait behind each other are kept together, up to so many bytes: a full lane loses them together.
inline constexpr std::size_t kTogetherBytes = 4096;
/// What an object counts beside its bytes.
inline constexpr std::size_t kFrameCost = 64;
/// What may wait for a peer without costing credit: all that a client of two query wires may have asked, taken back.
inline constexpr std::size_t kMostControl = 4 * kLaneWindow;

/// What is to be sent to one peer, in lanes that take turns: each a queue in order, bounded, with its own credit. A
/// wire has a lane of its own; those of one push port to one process share one, as they share each message. Not
/// synchronised: it belongs to the link.
class PeerLanes {
 public:
  enum class Rule {
    Control,     ///< always taken: no object, or one that its sender's credit bounds
    MustFit,     ///< refused when the lane is full
    DropOldest,  ///< a full lane loses its oldest, counted
  };
  struct Item {
    Block record;                            ///< of a push, perhaps with those of the messages behind it
    std::size_t messages = 1;                ///< that are counted where they are lost
    std::shared_ptr<const Payload> payload;  ///< what does not travel in the record
    Rule rule = Rule::Control;
    std::size_t cost = 0;
    std::uint64_t wire = 0;
    std::shared_ptr<const std::vector<std::uint64_t>> also;  ///< further wires
    std::size_t next_chunk = 0;
    std::shared_ptr<const void> receipt;  ///< goes when the item has, or is dropped
    std::size_t losses() const { return messages * (1 + (also ? also->size() : 0)); }
  };
  class Lane;
  struct Taken {
    bool ok = true;
    std::size_t lost = 0;  ///< messages that had to go, once for each of their wires
  };
  /// One ZeroMQ message: the record or records, and the chunk beside them, if any.
  struct Outgoing {
    Block records;
    std::shared_ptr<const Payload> payload;
    std::size_t chunk = 0;
    std::size_t bytes() const { return records.size() + (payload ? payload->chunks()[chunk].beside.size() : 0); }
  };

  /// A new lane. It goes when it is closed and empty.
  std::shared_ptr<Lane> open();
  /// Takes no more. What has begun, and what needs no credit, still goes; what waits for credit is lost, or goes too
  /// with `Rest::Goes`, as far as all lanes that are ending so keep no more than one window. Returns what was lost,
  /// once for each of its wires.
  enum class Rest { IsLost, Goes };
  std::size_t close(Lane& lane, Rest rest = Rest::IsLost);
  Taken offer(Lane& lane, Item item);
  /// Room for the record, of so many bytes, of a small message of a push behind those that wait in the lane already and
  /// are for that wire alone: it is counted as offered, and to be written before anything else is done with the lane.
  /// Null: there is none, and it is an item of its own.
  std::uint8_t* join(Lane& lane, std::uint64_t wire, std::size_t cost, std::size_t record_size);
  void credit(std::uint64_t lane, std::size_t bytes);
  bool has_ready() const { return !small_.empty() || !large_.empty(); }
  /// What is to go next; false when nothing may.
  bool next(Outgoing& out);
  std::size_t lanes() const { return lanes_.size(); }
  /// What waits without costing credit: it grows with what its sender does, and shrinks only as the peer reads.
  std::size_t control_bytes() const { return control_bytes_; }

 private:
  using Turns = std::deque<Lane*>;
  void update(Lane& lane);
  void take_chunk(Outgoing& out);
  void take_small(Outgoing& out);
  void begin(Lane& lane);

  std::unordered_map<std::uint64_t, std::shared_ptr<Lane>> lanes_;
  Turns small_;                 ///< lanes whose first item may go and fits into a record
  Turns large_;                 ///< lanes whose first item may go and does not
  std::vector<Block> records_;  ///< used again for each message
  bool small_is_next_ = true;
  std::uint64_t next_lane_ = 1;
  std::size_t control_bytes_ = 0;
};

class PeerLanes::Lane {
 public:
  explicit Lane(std::uint64_t id) : id_(id) {}
  std::uint64_t id() const { return id_; }
  /// Cost of what has not begun.
  std::size_t waiting() const { return waiting_; }

 private:
  friend class PeerLanes;
  bool may_go() const;
  bool is_full(std::size_t cost) const { return waiting_ > 0 && waiting_ + cost > kLaneWindow; }
  std::size_t drop_oldest();
  /// Returns its losses.
  std::size_t note_lost(const Item& item);

  const std::uint64_t id_;
  std::deque<Item> queue_;
  std::map<std::uint64_t, std::uint64_t> lost_;  ///< by wire, not yet told to its client
  std::size_t waiting_ = 0;
  std::size_t in_flight_ = 0;  ///< cost of what has begun and has not been credited
  Turns* turns_ = nullptr;     ///< in which it stands
  bool closed_ = false;
};

}  // namespace fiona::host
