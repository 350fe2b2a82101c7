#pragma once

#include <map>
#include <memory>
#include <mutex>

#include "fiona/hull.hpp"
#include "fiona/port.hpp"
#include "fiona/push.hpp"
#include "link_socket.hpp"

namespace fiona::host {

/// All wires from one push port to the clients of one process: each message crosses once, and names those it is for.
class FanOut final : public Sink {
 public:
  FanOut(std::shared_ptr<LinkSocket> link, LinkSocket::Lane lane, detail::PushProvider& provider)
      : link_(std::move(link)), lane_(std::move(lane)), provider_(provider) {}

  const LinkSocket::Lane& lane() const { return lane_; }
  /// [any thread] One more wire is to use it; false: it has as many as one message may name, or its last one has ended.
  bool take_on();
  /// [any thread] The wire receives what is put after `sequence`, every `prescale`-th, the first of it included.
  /// `each`: to a handler that receives each one, and that a put may wait for.
  void join(std::uint64_t wire, std::uint64_t sequence, std::uint32_t prescale, bool each);
  /// [any thread] From the next put on.
  void set_prescale(std::uint64_t wire, std::uint32_t prescale);
  /// [any thread] Nothing more is for the wire.
  void leave(std::uint64_t wire);
  /// [any thread] A wire that was taken on, and has left, ends. With the last one the lane does: `rest` of what was put
  /// before. Returns what was lost by that.
  std::size_t let_go(PeerLanes::Rest rest);
  /// [any thread] For this wire only.
  Outcome deliver_to(std::uint64_t wire, const Parcel& parcel);

  Outcome deliver(Parcel parcel) override;
  void repeat(Parcel parcel) override;
  void lease(bool held, const std::string& reason) override;
  std::size_t subscribers() const override;
  bool has_room(std::size_t bytes, const std::function<void()>& notice) override;
  /// [any thread] The wire's client says how much room it has.
  void on_room(std::uint64_t wire, std::size_t room);

 private:
  struct Member {
    std::uint64_t after = 0;
    std::uint32_t prescale = 1;
    std::uint64_t puts = 0;
    bool each = false;
    KnownRoom room;
    bool is_next() const { return puts % prescale == 0; }
    bool takes_next() { return puts++ % prescale == 0; }
  };
  Outcome send(const Parcel& parcel, std::vector<std::uint64_t>& wires);
  void address(wire::Frame& frame, const std::vector<std::uint64_t>& wires) const;
  /// The members share a lane, so what goes to one takes room from all. In virtual time a lane has no bound, and each
  /// wire must do as it would within a process.
  bool shares_room() const { return !provider_.hull().clock().staging(); }

  const std::shared_ptr<LinkSocket> link_;
  const LinkSocket::Lane lane_;
  detail::PushProvider& provider_;
  mutable std::mutex mutex_;
  std::size_t wires_ = 0;  ///< that were taken on, and not yet let go of: those that are joining and leaving, too
  bool closed_ = false;
  std::map<std::uint64_t, Member> members_;
  std::function<void()> notice_;       ///< of who waits for room
  std::vector<std::uint64_t> takers_;  ///< used again for each message, as is the frame
  wire::Frame frame_;
};

}  // namespace fiona::host
