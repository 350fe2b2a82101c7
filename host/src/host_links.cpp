#include "host_links.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>

#include "fiona/error.hpp"
#include "os/process.hpp"

namespace fiona::host {
namespace {

/// How exactly silence is noticed.
constexpr std::chrono::milliseconds kTick{50};
/// How often a leader is looked up in the allow-list again.
constexpr std::chrono::seconds kCheckEvery{1};
/// Requests of a leader that may wait; further ones get no answer, nor do those above `kMostUnread` bytes.
constexpr std::size_t kMaxChanges = 10'000;

std::uint64_t random_number() {
  const std::string bytes = os::random_token();
  std::uint64_t number = 0;
  std::memcpy(&number, bytes.data(), sizeof number);
  return number;
}

}  // namespace

HostLinks::HostLinks(const HostOptions& options, const std::string& name, Pool& pool, Clock& clock, Links& links,
                     OnEvent on_event, OnLog on_log)
    : keys_(options.keys) {
  if (!options.listen.empty() && !options.peers.empty()) {
    throw Error(ErrorCode::Usage,
                {.what = "a host that leads others is not led: --peer and --listen do not go together",
                 .next = "give --listen to the hosts that are led, and --peer to the one that leads"});
  }
  for (const PeerAddress& peer : options.peers) {
    if (!peer.address.empty() || !options.registry.empty()) continue;
    throw Error(ErrorCode::Usage, {.what = "nothing says where host '" + peer.name + "' is",
                                   .expected = "--peer NAME=HOST:PORT=KEY, or --registry http://HOST:PORT besides"});
  }
  for (std::size_t i = 0; i < options.peers.size(); ++i) {
    const auto same = [&](const PeerAddress& other) { return other.name == options.peers[i].name; };
    if (std::count_if(options.peers.begin(), options.peers.end(), same) == 1) continue;
    throw Error(ErrorCode::Usage, {.what = "two peers have the name '" + options.peers[i].name + "'",
                                   .next = "--peer NAME=HOST:PORT=KEY, each with a name of its own"});
  }
  const auto post = [this](HostChange change) {
    const bool droppable = change.what == HostChange::What::Request;
    if (droppable && (unread_ += change.request.ByteSizeLong()) > kMostUnread) return;
    changes_.push(std::move(change), droppable ? kMaxChanges : SIZE_MAX);
  };
  const auto tell = [this, on_event = std::move(on_event)](wire::GroupMessage event) {
    const bool is_counted = !event.has_tapped();
    on_event(std::move(event));
    if (is_counted) changes_.wake();  // for `changes`, once it has been dealt with
  };
  around_ = std::make_unique<HostSurroundings>(
      HostSurroundings{name, random_number(), keys_.pair(), pool, clock, links, context_, tell, post});
  if (!options.listen.empty()) {
    zap_ = std::make_unique<Zap>(context_, Zap::hosts(keys_), on_log);
    leader_ = std::make_unique<LeaderLink>(*around_, keys_, options.listen);
  }
  if (!options.registry.empty())
    around_->registry = std::make_unique<Registry>(options.registry, name, leader_ ? leader_->address() : "",
                                                   around_->keys.open, std::move(on_log));
  for (const auto& peer : options.peers) peers_.push_back(std::make_unique<PeerLink>(*around_, peer));
  thread_ = std::thread([this] { serve(); });
}

HostLinks::~HostLinks() { stop(); }

void HostLinks::stop() {
  stopping_ = true;
  if (thread_.joinable()) thread_.join();
  around_->registry.reset();
  for (auto& peer : peers_) peer->stop();
  if (leader_) leader_->stop();
}

/// Silence is a peer's only while this host could listen. A machine that was suspended, or stood still as a virtual one
/// may, would otherwise take everybody for dead the moment that it goes on.
void HostLinks::forgive(std::chrono::steady_clock::time_point now) {
  const auto stood_still = now - std::exchange(ticked_, now) - 2 * kTick;
  if (stood_still <= std::chrono::steady_clock::duration::zero()) return;
  for (auto& peer : peers_) peer->forgive(stood_still);
  if (leader_) leader_->forgive(stood_still);
}

void HostLinks::serve() {
  ticked_ = std::chrono::steady_clock::now();
  while (!stopping_) {
    if (zap_) {
      std::array<zmq::pollitem_t, 1> waits{{{zap_->socket().handle(), 0, ZMQ_POLLIN, 0}}};
      static_cast<void>(
          ::zmq_poll(waits.data(), waits.size(), kTick.count()));  // interrupted or not: what waits is served
      zap_->serve();
    } else {
      std::this_thread::sleep_for(kTick);
    }
    const auto now = std::chrono::steady_clock::now();
    forgive(now);
    for (auto& peer : peers_) peer->tick(now);
    if (leader_) leader_->tick(now);
    if (leader_) check_leader(now);
  }
}

/// `keys forget` ends a session that is open. A list that cannot be read lets nobody new in, and throws nobody out.
void HostLinks::check_leader(std::chrono::steady_clock::time_point now) {
  if (now - checked_ < kCheckEvery || leader_->leader().empty()) return;
  checked_ = now;
  try {
    leader_->keep(keys_.allowed());
  } catch (const Error&) {
    return;
  }
}

std::deque<HostChange> HostLinks::changes() {
  for (const auto& peer : peers_) peer->was_read();
  unread_ = 0;
  return changes_.take();
}

PeerLink* HostLinks::peer(const std::string& name) {
  const auto found =
      std::find_if(peers_.begin(), peers_.end(), [&name](const auto& peer) { return peer->peer().name == name; });
  return found == peers_.end() ? nullptr : found->get();
}

}  // namespace fiona::host
