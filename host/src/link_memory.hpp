#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>
#include <zmq.hpp>

#include "fiona/wire.pb.h"
#include "link_message.hpp"

namespace fiona::host {

/// What is copied into memory that the receiver reads costs less than the way through a socket from about this size on.
inline constexpr std::size_t kMemoryFrom = 64 * 1024;
/// Chunks of one link and direction that may be there at a time; what comes meanwhile takes the socket.
inline constexpr std::size_t kMemorySlots = 4;
/// Links of one process that have memory, 4 MiB each where all of it is used; further ones do without.
inline constexpr int kMostMemories = 32;

/// The memory of one link between two processes of a host that trust each other (docs/wire-protocol.md, 13), seen from
/// one of them. Each has memory of its own, which the other one only reads: chunks in slots, and how often it has done
/// with each slot of the other's. A sender takes a slot that the receiver has done with, or the socket: nobody waits.
/// Not synchronised: it belongs to the link.
class LinkMemory {
 public:
  /// What the peer is to be told before chunks can go this way; none: it has been, or there is no memory.
  std::optional<wire::Memory> offer();
  /// What the peer has told, and the answer to it, if any.
  std::optional<wire::Memory> on_told(const wire::Memory& told);
  /// Copies a chunk; the message that says where to. None: no slot is free, or the peer does not see this memory.
  std::optional<zmq::message_t> put(std::string_view chunk);
  /// [reader] Of a message in three parts, as `put` makes the third: the second is the chunk then, in the peer's
  /// memory, whose slot is free again once that part has gone. False: it is no such message.
  bool take(std::vector<zmq::message_t>& parts);

 private:
  class Ours;
  class Theirs;
  struct Lent;
  wire::Memory make();
  wire::Memory decline();

  std::shared_ptr<Ours> ours_;
  std::shared_ptr<const Theirs> theirs_;
  bool is_seen_ = false;                              ///< ours, by the peer
  bool declined_ = false;                             ///< by either side: everything takes the socket
  std::array<std::uint64_t, kMemorySlots> filled_{};  ///< how often each of our slots was
};

}  // namespace fiona::host
