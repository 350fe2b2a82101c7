// The proof of the key, both ways: link_keys.hpp has what is computed.
#include <utility>

#include "link_keys.hpp"
#include "link_peer.hpp"

namespace fiona::host {

/// Of somebody who has proved nothing yet: only the proof itself is looked at.
void LinkSocket::shake_hands(const std::string& peer) {
  struct Single final : FrameReader::Receiver {
    std::optional<std::uint64_t> accepts(const wire::Frame&) override { return std::nullopt; }
    void on_frame(const wire::Frame& one, const ObjectBytes& object) override {
      const bool alone = !std::exchange(others, true);
      frame = alone && one.wire() == 0 && object.size() == 0 ? one : wire::Frame();
    }
    wire::Frame frame;
    bool others = false;
  } single;
  FrameReader reader;
  if (parts_.size() == 1) reader.read(parts_, single);
  if (routed_ && (single.frame.has_hello() || single.frame.has_proof())) return welcome(peer, single.frame);
  if (!routed_ && single.frame.has_challenge()) return check_challenge(single.frame);
  if (!routed_ && single.frame.has_refused()) return receiver_.on_refused(told_reason(single.frame.refused().reason()));
  ++counters_.unproven;
}

void LinkSocket::welcome(const std::string& peer, const wire::Frame& frame) {
  const bool hello = frame.has_hello();
  const std::string& name = hello ? frame.hello().client() : frame.proof().client();
  const std::string& nonce = hello ? frame.hello().nonce() : frame.proof().nonce();
  wire::Frame answer;
  if (hello && frame.hello().version() != wire::VERSION_1) {
    answer.mutable_refused()->set_reason(kUnknownVersion);
    const std::lock_guard lock(mutex_);
    return send_plain(peer, answer);
  }
  if (nonce.size() != kNonceBytes) return void(++counters_.unproven);
  const std::string key = link_key(keys_.own, name);
  const std::string ours = derived_nonce(secret_, peer + nonce + name);
  if (hello) {
    answer.mutable_challenge()->set_nonce(ours);
    answer.mutable_challenge()->set_proof(link_proof(key, LinkSide::Provider, nonce, ours));
    answer.mutable_challenge()->set_memory_proof(memory_proof(key, LinkSide::Provider, nonce, ours));
    const std::lock_guard lock(mutex_);
    return send_plain(peer, answer);
  }
  if (!same_proof(frame.proof().proof(), link_proof(key, LinkSide::Client, nonce, ours))) {
    ++counters_.unproven;
    return;
  }
  const std::lock_guard lock(mutex_);
  forget_locked(name);  // a process has one link: what it leaves behind does not add up
  const auto added = add_peer(peer, name, true);
  const std::string memory = memory_proof(key, LinkSide::Client, nonce, ours);
  if (!memory.empty() && same_proof(frame.proof().memory_proof(), memory)) added->memory.emplace();
}

/// Of this link: passed on over another one it proves nothing. Empty: it shares no memory.
std::string LinkSocket::memory_proof(const std::string& key, LinkSide side, const std::string& client_nonce,
                                     const std::string& provider_nonce) const {
  if (keys_.memory.empty()) return {};
  return link_proof(memory_key(keys_.memory, key), side, client_nonce, provider_nonce);
}

void LinkSocket::check_challenge(const wire::Frame& frame) {
  const auto& challenge = frame.challenge();
  if (!same_proof(challenge.proof(), link_proof(keys_.own, LinkSide::Provider, nonce_, challenge.nonce()))) {
    ++counters_.unproven;
    return receiver_.on_refused("the process that listens there does not know the system's key");
  }
  wire::Frame answer;
  answer.mutable_proof()->set_client(name_);
  answer.mutable_proof()->set_nonce(nonce_);
  answer.mutable_proof()->set_proof(link_proof(keys_.own, LinkSide::Client, nonce_, challenge.nonce()));
  answer.mutable_proof()->set_memory_proof(memory_proof(keys_.own, LinkSide::Client, nonce_, challenge.nonce()));
  const std::string memory = memory_proof(keys_.own, LinkSide::Provider, nonce_, challenge.nonce());
  const std::lock_guard lock(mutex_);
  send_plain("", answer);
  const auto provider = peers_.find("");
  if (provider == peers_.end()) return;
  provider->second->proven = true;
  if (!memory.empty() && same_proof(challenge.memory_proof(), memory)) provider->second->memory.emplace();
  pump(*provider->second);
}

}  // namespace fiona::host
