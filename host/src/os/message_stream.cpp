#include "os/message_stream.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>

namespace fiona::os {

MessageStream::MessageStream(Descriptor socket) : socket_(std::move(socket)) {
  ::fcntl(socket_.get(), F_SETFL, ::fcntl(socket_.get(), F_GETFL) | O_NONBLOCK);
}

bool MessageStream::receive() {
  char buffer[65536];
  for (std::size_t received = 0; !closed() && received < kMaxReceived;) {
    const auto size = ::recv(socket_.get(), buffer, sizeof buffer, 0);
    if (size > 0) {
      in_.append(buffer, static_cast<std::size_t>(size));
      received += static_cast<std::size_t>(size);
      if (in_.size() - in_begin_ > kMaxMessage + sizeof buffer) return true;  // let the reader catch up
      continue;
    }
    if (size < 0 && errno == EINTR) continue;
    if (size < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return true;
    closed_ = true;
  }
  return !closed();
}

/// Of the message that is next, once those 4 bytes are there.
std::size_t MessageStream::next_length() const {
  const auto* head = reinterpret_cast<const unsigned char*>(in_.data() + in_begin_);
  return head[0] | head[1] << 8 | head[2] << 16 | static_cast<std::size_t>(head[3]) << 24;
}

bool MessageStream::has_next() const {
  const std::size_t waiting = in_.size() - in_begin_;
  return fault_.empty() && waiting >= 4 && (waiting >= 4 + next_length() || next_length() > kMaxMessage);
}

bool MessageStream::next(google::protobuf::MessageLite& message) {
  if (!fault_.empty() || in_.size() - in_begin_ < 4) return false;
  const std::size_t length = next_length();
  if (length > kMaxMessage) {
    fault_ = "a message of " + std::to_string(length) + " bytes, where at most " + std::to_string(kMaxMessage) +
             " are taken";
    return false;
  }
  if (in_.size() - in_begin_ < 4 + length) return false;
  if (!message.ParseFromArray(in_.data() + in_begin_ + 4, static_cast<int>(length))) {
    fault_ = std::to_string(length) + " bytes that are no " + message.GetTypeName();
    return false;
  }
  in_begin_ += 4 + length;
  if (in_begin_ == in_.size()) {
    in_.clear();
    in_begin_ = 0;
  } else if (in_begin_ > in_.size() / 2) {
    in_.erase(0, in_begin_);
    in_begin_ = 0;
  }
  return true;
}

bool MessageStream::send(const google::protobuf::MessageLite& message) {
  const std::size_t length = message.ByteSizeLong();
  if (closed_ || length > kMaxMessage || unsent() + length > kMaxUnsent) return false;
  for (int shift = 0; shift < 32; shift += 8) out_ += static_cast<char>(length >> shift & 0xff);
  message.AppendToString(&out_);
  return flush();
}

bool MessageStream::flush() {
  while (!closed_ && unsent() > 0) {
    const auto size = ::send(socket_.get(), out_.data() + out_begin_, unsent(), MSG_NOSIGNAL);
    if (size > 0) {
      out_begin_ += static_cast<std::size_t>(size);
      continue;
    }
    if (size < 0 && errno == EINTR) continue;
    if (size < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) break;
    closed_ = true;
  }
  if (out_begin_ == out_.size()) {
    out_.clear();
    out_begin_ = 0;
  } else if (out_begin_ > (1U << 20)) {
    out_.erase(0, out_begin_);
    out_begin_ = 0;
  }
  return !closed_;
}

bool MessageStream::flush_all() {
  while (flush() && unsent() > 0) {
    pollfd wait{socket_.get(), POLLOUT, 0};
    ::poll(&wait, 1, -1);
  }
  return !closed_;
}

void MessageStream::shut_down() {
  closed_ = true;
  ::shutdown(socket_.get(), SHUT_RDWR);
}

bool MessageStream::wait_readable(std::chrono::steady_clock::time_point deadline) const {
  while (true) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now()).count();
    pollfd wait{socket_.get(), POLLIN, 0};
    const int ready = ::poll(&wait, 1, static_cast<int>(std::clamp<std::int64_t>(left, 0, 60'000)));
    if (ready > 0) return true;
    if (ready < 0 && errno == EINTR) continue;
    if (left <= 0) return false;
  }
}

}  // namespace fiona::os
