#pragma once

#include <google/protobuf/message_lite.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <string>

#include "os/descriptor.hpp"

namespace fiona::os {

/// Protobuf messages over a stream socket, each preceded by its length as 4 bytes, little endian. Reading never
/// blocks; writing keeps what the socket does not take, up to a bound. One thread may read while another writes.
class MessageStream {
 public:
  static constexpr std::size_t kMaxMessage = 16 * 1024 * 1024;  ///< bytes; a longer one ends the stream
  static constexpr std::size_t kMaxUnsent = 32 * 1024 * 1024;   ///< bytes; a reader this slow is cut off
  static constexpr std::size_t kMaxReceived = 1024 * 1024;      ///< bytes at once

  explicit MessageStream(Descriptor socket);

  int descriptor() const { return socket_.get(); }
  /// Reads what there is, up to a bound: who never stops to speak does not keep the reader from what else there is to
  /// do. False when the peer has closed, broken the framing, or the stream failed.
  bool receive();
  /// Whether one has come that `next` would give.
  bool has_next() const;
  /// Parses the next complete message; false when there is none. After a malformed one nothing more is read, and
  /// `fault` says what it was.
  bool next(google::protobuf::MessageLite& message);
  /// Whether a message is not too large to be sent at all.
  static bool fits(const google::protobuf::MessageLite& message) { return message.ByteSizeLong() <= kMaxMessage; }
  /// Queues and sends as much as goes now. False when the stream is closed, too much is unsent, or it does not fit.
  bool send(const google::protobuf::MessageLite& message);
  /// Sends more of what is queued. False when the stream has failed.
  bool flush();
  std::size_t unsent() const { return out_.size() - out_begin_; }
  bool closed() const { return closed_ || !fault_.empty(); }
  const std::string& fault() const { return fault_; }

  /// Sends all that is queued, however slow the reader. False when the stream has failed.
  bool flush_all();
  /// [any thread] Ends the stream in both directions, and whoever waits for it.
  void shut_down();

  /// Blocks until the socket is readable, at most until `deadline`; false when that passes.
  bool wait_readable(std::chrono::steady_clock::time_point deadline) const;

 private:
  std::size_t next_length() const;

  Descriptor socket_;
  std::string in_;
  std::size_t in_begin_ = 0;
  std::string out_;
  std::size_t out_begin_ = 0;
  std::string fault_;
  std::atomic<bool> closed_{false};
};

}  // namespace fiona::os
