#include "zap.hpp"

#include <algorithm>
#include <vector>

#include "fiona/error.hpp"
#include "uninterrupted.hpp"

namespace fiona::host {
namespace {

constexpr std::chrono::seconds kTellEvery{5};
/// version, request, domain, address, identity, mechanism, credentials
constexpr std::size_t kParts = 7;

template <class Entries>
bool is_in(const Entries& list, const trust::Key& key) {
  return std::any_of(list.begin(), list.end(), [&key](const auto& one) { return one.key == key; });
}

}  // namespace

Zap::Policy Zap::hosts(trust::KeyDirectory keys) {
  const auto has = [keys = std::move(keys)](const trust::Key& key) { return is_in(keys.allowed(), key); };
  return {has, "host", "fiona keys allow NAME KEY"};
}

Zap::Policy Zap::consoles(trust::KeyDirectory keys) {
  const auto has = [keys = std::move(keys)](const trust::Key& key) { return is_in(keys.consoles(), key); };
  return {has, "console", "fiona keys allow NAME KEY as observe"};
}

Zap::Zap(zmq::context_t& context, Policy policy, OnRefused on_refused)
    : policy_(std::move(policy)), on_refused_(std::move(on_refused)), socket_(context, zmq::socket_type::rep) {
  socket_.set(zmq::sockopt::linger, 0);
  socket_.bind("inproc://zeromq.zap.01");
}

/// Empty, with the reason, for one who is not let in. A list that cannot be read lets nobody in.
std::string Zap::user_of(const std::string& credentials, std::string& why) const {
  const auto key = trust::Key::from_bytes(credentials);
  try {
    if (key && policy_.has(*key)) return key->text();
    why = "its key is not in the list of " + policy_.noun + "s that may connect";
  } catch (const Error& error) {
    why = error.text().what + " (" + error.text().where + ")";
  }
  return "";
}

void Zap::note_refusal(const std::string& address, const std::string& credentials, const std::string& why) {
  ++refused_;
  const auto now = std::chrono::steady_clock::now();
  if (told_ != decltype(told_){} && now - told_ < kTellEvery) return;
  told_ = now;
  const auto key = trust::Key::from_bytes(credentials);
  std::string command = policy_.command;
  if (key) command.replace(command.find("KEY"), 3, key->text());
  on_refused_("refused a " + policy_.noun + " at " + address + ", " + std::to_string(refused_) +
              " times so far: " + why + (key ? "; to let it in: " + command : ""));
}

void Zap::serve() {
  while (true) {
    std::vector<std::string> parts;
    bool more = true;
    while (more) {
      zmq::message_t part;
      if (!received(socket_, part)) return;
      if (parts.size() < kParts) parts.push_back(part.to_string());
      more = part.more();
    }
    parts.resize(kParts);
    std::string why = "it speaks " + parts[5] + ", not CURVE";
    const std::string user = parts[5] == "CURVE" ? user_of(parts[6], why) : "";
    if (user.empty()) note_refusal(parts[3], parts[6], why);
    const std::vector<std::string> answer{
        "1.0", parts[1], user.empty() ? "400" : "200", user.empty() ? "not allowed" : "OK", user, ""};
    for (std::size_t i = 0; i < answer.size(); ++i) {
      sent(socket_, zmq::buffer(answer[i]), i + 1 < answer.size() ? zmq::send_flags::sndmore : zmq::send_flags::none);
    }
  }
}

}  // namespace fiona::host
