// Wires that pass through this process, unread.
#include <algorithm>

#include "fiona/error.hpp"
#include "links.hpp"

namespace fiona::host {
namespace {

/// Of what a lane has lost its sender is told all but one part in so many.
constexpr std::size_t kPortionsOfLost = 64;
/// Of what costs no credit so much may wait for one side of a wire: a wire of which more does is cut, before its side
/// is let go with all that others have there.
constexpr std::size_t kMostFree = kMostControl / 2;

/// Frames without credit that wait to be passed on.
struct Waiting {
  Waiting(std::shared_ptr<std::atomic<std::size_t>> a, std::size_t b) : all(std::move(a)), bytes(b) { *all += bytes; }
  Waiting(const Waiting&) = delete;
  Waiting& operator=(const Waiting&) = delete;
  ~Waiting() { *all -= bytes; }
  const std::shared_ptr<std::atomic<std::size_t>> all;
  const std::size_t bytes;
};

}  // namespace

class Links::RelayLane {
 public:
  RelayLane(const Hop& to, LinkCounters& counters)
      : link_(to.link), lane_(to.link->open_lane(to.peer)), counters_(counters) {}
  RelayLane(const RelayLane&) = delete;
  RelayLane& operator=(const RelayLane&) = delete;
  ~RelayLane() {
    const std::size_t lost = link_->close_lane(lane_, rest_);
    (rest_ == PeerLanes::Rest::Goes ? counters_.overrun : counters_.late) += lost;
  }
  const LinkSocket::Lane& lane() const { return lane_; }
  /// So many more are lost here, once for each wire. Returns how many its sender is to be told now: the first ones
  /// each, then in portions, or who floods one that does not read would be flooded in turn.
  std::size_t note_lost(std::size_t messages) {
    untold_ += messages;
    if (untold_ < told_ / kPortionsOfLost) return 0;
    told_ += untold_;
    return std::exchange(untold_, 0);
  }
  /// Its peer has gone. Returns what is lost by that, and has not been told.
  std::size_t end() { return std::exchange(untold_, 0) + link_->close_lane(lane_); }
  /// A wire has ended behind what waits here: it goes before it, as it would have gone from who sent it.
  void keep_rest() { rest_ = PeerLanes::Rest::Goes; }

 private:
  const std::shared_ptr<LinkSocket> link_;
  const LinkSocket::Lane lane_;
  LinkCounters& counters_;
  PeerLanes::Rest rest_ = PeerLanes::Rest::IsLost;
  std::size_t told_ = 0;
  std::size_t untold_ = 0;
};

void Links::relay(std::uint64_t wire, std::string token, std::string peer, Endpoint endpoint) {
  const std::lock_guard lock(mutex_);
  relays_[wire] = Relay{std::move(token), std::move(peer), std::move(endpoint), {}, {}};
}

void Links::open_relay(const Hop& from, const wire::Frame& frame, Relay& relay) {
  if (relay.token != frame.open().token() || relay.client.hop.link || !may_open(from, relay.peer)) {
    return refuse(from, frame.wire(), kNotGranted);
  }
  try {
    relay.provider.hop = connect(relay.endpoint);
  } catch (const Error& error) {
    return refuse(from, frame.wire(), error.text().what);
  } catch (const std::exception& error) {  // no descriptor is left, or no memory
    return refuse(from, frame.wire(), error.what());
  }
  relay.client.hop = from;
  forward(from, relay.provider, frame, {}, nullptr);
}

bool Links::is_relayed(const wire::Frame& frame) {
  const std::lock_guard lock(mutex_);
  const auto is_known = [this](std::uint64_t wire) { return relays_.contains(wire); };
  return is_known(frame.wire()) || std::any_of(frame.also().begin(), frame.also().end(), is_known);
}

/// Passes the frame on over those of its wires that are relayed here, each side's towards the other. What is left of it
/// is for wires that end here; null: nothing is. Called with the mutex held.
const wire::Frame* Links::pass_on(const Hop& from, const wire::Frame& frame, const ObjectBytes& object,
                                  const std::shared_ptr<const Payload>& payload, wire::Frame& rest) {
  std::vector<std::uint64_t> ending;
  std::vector<std::pair<Relay::Side*, wire::Frame>> ways;  // those of one hop share what crosses, as they did before
  const auto sort = [&](std::uint64_t wire) {
    const auto found = relays_.find(wire);
    if (found == relays_.end()) return ending.push_back(wire);
    Relay::Side& client = found->second.client;
    Relay::Side& provider = found->second.provider;
    if (!client.hop.link || (from != client.hop && from != provider.hop)) return note_foreign(wire, frame);
    Relay::Side& to = from == client.hop ? provider : client;
    const auto way = std::find_if(ways.begin(), ways.end(), [&](const auto& one) { return one.first->hop == to.hop; });
    if (way != ways.end()) return way->second.add_also(wire);
    auto& passed = ways.emplace_back(&to, frame).second;
    passed.set_wire(wire);
    passed.clear_also();
  };
  sort(frame.wire());
  for (const std::uint64_t wire : frame.also()) sort(wire);
  std::vector<std::uint64_t> flooded;
  for (const auto& [to, passed] : ways) {
    if (forward(from, *to, passed, object, payload)) continue;
    flooded.push_back(passed.wire());
    flooded.insert(flooded.end(), passed.also().begin(), passed.also().end());
  }
  if (frame.has_closed() || frame.has_refused()) {
    for (const auto& [to, passed] : ways) {
      if (to->lane) to->lane->keep_rest();
    }
    for (const auto& [to, passed] : ways) {
      // The provider answers the client's end with its own, behind all that was on its way.
      if (to == &relays_.at(passed.wire()).provider) continue;
      note_ended(passed.wire());
      relays_.erase(passed.wire());
    }
  }
  for (const std::uint64_t wire : flooded) cut_relay(wire, "too much that costs no credit waits on its way");
  if (ways.empty() && ending.size() == 1U + static_cast<std::size_t>(frame.also_size())) return &frame;
  if (ending.empty()) return nullptr;
  rest = frame;
  rest.set_wire(ending.front());
  rest.clear_also();
  for (std::size_t i = 1; i < ending.size(); ++i) rest.add_also(ending[i]);
  return &rest;
}

/// Called with the mutex held, as is what follows. Both sides are told.
void Links::cut_relay(std::uint64_t wire, const std::string& reason) {
  const auto found = relays_.find(wire);
  if (found == relays_.end()) return;
  wire::Frame frame = frame_for(wire);
  frame.mutable_closed()->set_reason(told_reason(reason));
  for (const Hop& hop : {found->second.client.hop, found->second.provider.hop}) {
    if (hop.link) hop.link->tell(hop.peer, frame);
  }
  relays_.erase(found);
  note_ended(wire);
}

/// A frame without an object goes behind the objects of its wire. A push loses its oldest where the next process is
/// slow, which both its ends are told; for all else its sender has credit once it has left. False: too much waits there
/// already that costs no credit.
bool Links::forward(const Hop& from, Relay::Side& to, const wire::Frame& frame, const ObjectBytes& object,
                    const std::shared_ptr<const Payload>& payload) {
  if (frame.lane() != 0) {
    auto& known = relay_lanes_[{from.link.get(), from.peer, frame.lane(), to.hop.link.get(), to.hop.peer}];
    to.lane = known.lock();
    if (!to.lane) {
      known = to.lane = std::make_shared<RelayLane>(to.hop, counters_);
      std::erase_if(relay_lanes_, [](const auto& entry) { return entry.second.expired(); });
    }
    for (const std::uint64_t other : frame.also()) {
      Relay& relay = relays_.at(other);
      (from == relay.client.hop ? relay.provider : relay.client).lane = to.lane;
    }
  }
  const LinkSocket::Lane lane = to.lane ? to.lane->lane() : LinkSocket::Lane();
  const bool is_push = frame.has_object() && &to == &relays_.at(frame.wire()).client;
  if (!is_push) {
    const bool is_free = frame.lane() == 0;
    const bool ends = frame.has_closed() || frame.has_refused();
    if (is_free && !ends && *to.free > kMostFree) return void(++counters_.overrun), false;
    std::shared_ptr<const void> receipt = from.link->receipt();
    if (is_free) receipt = std::make_shared<const Waiting>(to.free, frame.ByteSizeLong() + kFrameCost);
    to.hop.link->forward(lane, to.hop.peer, frame, object, payload, LinkSocket::Rule::Control, std::move(receipt));
    return true;
  }
  // Others share its lane as far as here: one that does not read must not keep their credit.
  const std::size_t lost =
      to.hop.link->forward(lane, to.hop.peer, frame, object, payload, LinkSocket::Rule::DropOldest, nullptr);
  if (lost > 0) tell_lost(from, frame.wire(), to.lane ? to.lane->note_lost(lost) : lost);
  return true;
}

void Links::tell_lost(const Hop& to, std::uint64_t wire, std::size_t messages) {
  if (messages == 0) return;
  wire::Frame frame = frame_for(wire);
  frame.mutable_lost()->set_messages(messages);
  to.link->tell(to.peer, frame);
}

/// Called with the mutex held. The side that is left is told, also of what had not left for the one that has gone.
void Links::lose_relays(const std::string& endpoint, const std::string& name, const std::string& reason) {
  for (auto it = relays_.begin(); it != relays_.end();) {
    auto& [wire, relay] = *it;
    const bool provider_gone = relay.endpoint.address == endpoint;
    if (!provider_gone && relay.peer != name) {
      ++it;
      continue;
    }
    const Hop& left = provider_gone ? relay.client.hop : relay.provider.hop;
    const auto& lane = provider_gone ? relay.provider.lane : relay.client.lane;
    if (left.link) tell_lost(left, wire, lane ? lane->end() : 0);
    wire::Frame frame = frame_for(wire);
    frame.mutable_closed()->set_reason(told_reason(reason));
    if (left.link) left.link->tell(left.peer, frame);
    note_ended(wire);
    it = relays_.erase(it);
  }
}

}  // namespace fiona::host
