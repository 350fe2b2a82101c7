#pragma once

#include <map>
#include <memory>
#include <mutex>

#include "fiona/port.hpp"
#include "fiona/push.hpp"
#include "link_socket.hpp"

namespace fiona::host {

/// All wires from one push port to the clients of one process: each message crosses once, and names those it is for.
class FanOut final : public Sink {
 public:
  FanOut(std::shared_ptr<LinkSocket> link, LinkSocket::Lane lane, detail::PushProvider& provider)
      : link_(std::move(link)), lane_(std::move(lane)), provider_(provider) {}
  ~FanOut() override { link_->close_lane(lane_); }

  const LinkSocket::Lane& lane() const { return lane_; }
  /// [any thread] The wire receives what is put after `sequence`, every `prescale`-th, the first of it included.
  void join(std::uint64_t wire, std::uint64_t sequence, std::uint32_t prescale);
  /// [any thread]
  void leave(std::uint64_t wire);
  /// [any thread] For this wire only.
  Outcome deliver_to(std::uint64_t wire, const Parcel& parcel);

  Outcome deliver(Parcel parcel) override;
  void lease(bool held, const std::string& reason) override;
  std::size_t subscribers() const override;

 private:
  struct Member {
    std::uint64_t after = 0;
    std::uint32_t prescale = 1;
    std::uint64_t puts = 0;
    bool takes_next() { return puts++ % prescale == 0; }
  };
  Outcome send(const Parcel& parcel, std::vector<std::uint64_t>& wires);

  const std::shared_ptr<LinkSocket> link_;
  const LinkSocket::Lane lane_;
  detail::PushProvider& provider_;
  mutable std::mutex mutex_;
  std::map<std::uint64_t, Member> members_;
  std::vector<std::uint64_t> takers_;  ///< used again for each message, as is the frame
  wire::Frame frame_;
};

}  // namespace fiona::host
