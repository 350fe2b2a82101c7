#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>
#include <zmq.hpp>

#include "link_keys.hpp"
#include "link_message.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {

/// A peer of a listening link, by hand: it may prove the key, and send whatever it likes.
class RawPeer {
 public:
  using Message = std::vector<std::string_view>;  ///< its parts

  RawPeer(zmq::context_t& context, const std::string& endpoint, const std::string& name)
      : RawPeer(context, endpoint, name, name) {}
  /// `reads_ahead`: so many messages at most wait here to be received; 0: as many as come.
  RawPeer(zmq::context_t& context, const std::string& endpoint, std::string name, const std::string& routing_id,
          int reads_ahead = 0)
      : name_(std::move(name)), socket_(context, zmq::socket_type::dealer) {
    socket_.set(zmq::sockopt::routing_id, routing_id);
    socket_.set(zmq::sockopt::rcvtimeo, 5000);
    socket_.set(zmq::sockopt::rcvhwm, reads_ahead);
    socket_.set(zmq::sockopt::linger, 0);
    socket_.connect(endpoint);
  }

  void prove(const std::string& provider_key) {
    wire::Frame hello;
    hello.mutable_hello()->set_version(wire::VERSION_1);
    hello.mutable_hello()->set_client(name_);
    hello.mutable_hello()->set_nonce(nonce_);
    send(hello);
    const std::string theirs = receive().challenge().nonce();
    wire::Frame proof;
    proof.mutable_proof()->set_client(name_);
    proof.mutable_proof()->set_nonce(nonce_);
    proof.mutable_proof()->set_proof(link_proof(link_key(provider_key, name_), LinkSide::Client, nonce_, theirs));
    send(proof);
  }
  void send(const wire::Frame& frame, std::string_view object = {}) {
    Block record = make_record(frame, nullptr, 0);
    for (int i = 0; i < 4; ++i) record.data()[4 + i] = static_cast<std::uint8_t>(object.size() >> (8 * i));
    std::string text(reinterpret_cast<const char*>(record.data()), record.size());
    text += object;
    send(Message{text});
  }
  /// Whether it could be sent at once.
  bool try_send(const Message& message) {
    return sent(socket_, zmq::buffer(message.front()));
  }
  void send(const Message& message) {
    for (std::size_t i = 0; i < message.size(); ++i) {
      const auto more = i + 1 < message.size() ? zmq::send_flags::sndmore : zmq::send_flags::none;
      given_to_zmq();
      uninterrupted([&] { return socket_.send(zmq::buffer(message[i]), more); });
    }
  }
  /// The first frame of the next message. Throws when there is none within five seconds.
  wire::Frame receive() {
    zmq::message_t answer;
    wire::Frame frame;
    if (!uninterrupted([&] { return socket_.recv(answer); })) throw std::runtime_error("nothing has come");
    got_from_zmq();
    const auto* in = static_cast<const std::uint8_t*>(answer.data());
    const std::size_t size = in[0] | in[1] << 8;
    if (!frame.ParseFromArray(in + kRecordHead, static_cast<int>(size))) throw std::runtime_error("this is no frame");
    for (bool more = answer.more(); more; more = answer.more()) {
      if (!received(socket_, answer)) throw std::runtime_error("the rest has not come");
    }
    return frame;
  }
  void read_away() {
    for (zmq::message_t answer; received(socket_, answer);) continue;
  }

 private:
  const std::string name_;
  const std::string nonce_ = std::string(kNonceBytes, 'n');
  zmq::socket_t socket_;
};

}  // namespace fiona::host
