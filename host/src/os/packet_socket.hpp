#pragma once

#include <chrono>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "os/descriptor.hpp"

namespace fiona::os {

/// What travels as one: text, and descriptors of the sender's that become the receiver's.
struct Packet {
  std::string text;
  std::vector<Descriptor> descriptors;
};

/// A socket of packets between two processes of one machine: each arrives whole or not at all, so that who comes after
/// one that was killed in the middle of its work finds no half of anything.
class PacketSocket {
 public:
  static constexpr std::size_t kMaxText = 64 * 1024;  ///< bytes
  static constexpr std::size_t kMaxDescriptors = 8;   ///< of one packet
  enum class Got { Packet, Nothing, End };
  /// Crowded: the processes of this user have too many descriptors under way (unix(7), ETOOMANYREFS). Nobody tells when
  /// that is over, and there is room in the socket all the while.
  enum class Sent { Yes, Full, Crowded, Gone };
  static constexpr std::chrono::milliseconds kCrowded{10};  ///< after which it is worth another try

  PacketSocket() = default;
  explicit PacketSocket(Descriptor socket);
  /// Two that are connected.
  static std::pair<PacketSocket, PacketSocket> pair();

  int descriptor() const { return socket_.get(); }
  explicit operator bool() const { return static_cast<bool>(socket_); }
  void close() { socket_.reset(); }
  /// Never waits.
  Sent send(std::string_view text, const std::vector<int>& descriptors = {}) const;
  /// Waits for room, at most so long. False: the other side has gone, or does not read.
  bool send_within(std::chrono::milliseconds time, std::string_view text,
                   const std::vector<int>& descriptors = {}) const;
  /// Never waits. A packet whose descriptors do not fit into this process any more comes without them.
  Got receive(Packet& packet) const;
  /// Waits for the next, at most until then. False: none came, or the other side has gone.
  bool receive_until(std::chrono::steady_clock::time_point deadline, Packet& packet) const;

 private:
  Descriptor socket_;
};

}  // namespace fiona::os
