// Groups whose process has ended are started again, with all that they are meant to hold.
#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <iostream>

#include "fiona/error.hpp"
#include "system.hpp"

namespace fiona::host {

/// Of a run on virtual time the end of a process is part of the result: it is not mended.
void System::start_again_later(const std::string& group, const std::string& reason) {
  if (!options_.restarts_groups || virtual_time_) return;
  const auto lost = lost_in(group);
  if (lost.empty()) return;
  if (const std::string host = host_of(group); !host.empty() && !hosts_->peer(host)->joined()) {
    for (const auto& [order, name] : lost)
      lost_[name].reason = fmt::format("{}; it is loaded again once host '{}' has joined", reason, host);
    waiting_for_host_.insert(group);
    return;
  }
  const bool again = supervision_.ended(group, std::chrono::steady_clock::now(), reason).has_value();
  for (const auto& [order, name] : lost) {
    lost_[name].reason = again ? reason + "; it is started again"
                               : fmt::format("{}; left, after {} restarts within {} s", reason, Supervision::kRestarts,
                                             Supervision::kWithin.count());
  }
}

/// Of all that live in a group, in the reverse order of their loading.
std::vector<wire::GroupRequest> System::ends_of(const std::string& group) const {
  std::map<std::uint64_t, std::string, std::greater<>> ordered;
  for (const std::string& name : model_.names_in(group)) {
    if (!lost_.contains(name)) ordered[model_.instance(name).order] = name;
  }
  std::vector<wire::GroupRequest> ends;
  for (const auto& [order, name] : ordered) ends.emplace_back().mutable_destroy()->set_instance(name);
  return ends;
}

void System::end_main() {
  for (const auto& destroy : ends_of(std::string(kMainGroup))) {
    if (options_.supervisor) options_.supervisor->beat();
    try {
      groups_.main().request(destroy);
    } catch (const Error& error) {
      std::cerr << destroy.destroy().instance() << ": " << error.text().what << "\n";
    }
  }
}

void System::end_instances() {
  const auto children = child_groups();
  for (ChildGroup* group : children) {
    for (const auto& destroy : ends_of(group->name())) group->tell(destroy);
    group->ask_status();  // whose answer comes behind all that they say
  }
  end_main();
  for (ChildGroup* group : children) group->status(kEndsItself);
}

void System::leave_to_supervision(const std::string& name) {
  dispose_standby(name);
  if (!lost_.contains(name) || is_being_made(name)) return;
  const std::string& group = model_.instance(name).group;
  if (!supervision_.waits(group)) start_again_later(group, lost_[name].reason);
}

/// This system's own instances that ended with their group and are to come back with it, in the order of their loading.
/// Of one that another version stands by for, that one takes the place.
std::map<std::uint64_t, std::string> System::lost_in(const std::string& group) const {
  std::map<std::uint64_t, std::string> ordered;
  for (const std::string& name : model_.names_in(group)) {
    const auto lost = lost_.find(name);
    const Model::Instance& one = model_.instance(name);
    const bool wakes = candidate_ && candidate_->is_back && candidate_->name == name;
    const bool comes_back = !one.led && !wakes && !standbys_.contains(name) && !making_.contains({group, name});
    if (lost != lost_.end() && !lost->second.away && comes_back) ordered[one.order] = name;
  }
  return ordered;
}

std::string System::start_again(const std::string& name) {
  const auto lost = lost_in(name);
  if (lost.empty()) {
    supervision_.forget(name);
    return "";
  }
  std::vector<std::string> lines{
      fmt::format("group '{}' is started again: {}", name, lost_[lost.begin()->second].reason)};
  try {
    Group& target = group(name);
    if (auto* remote = dynamic_cast<RemoteGroup*>(&target)) {
      if (!resume(*remote, lines)) {  // what was made, and not answered, goes first
        if (remote->end().empty()) start_again_later(name, "its host does not answer");
        return fmt::format("{}", fmt::join(lines, "\n"));
      }
      remote->compare_at(std::chrono::steady_clock::now());  // the rest of what may be in doubt
    }
    for (const auto& [order, instance] : lost) make_again(target, instance);
    if (!target.alive()) lose_if_gone(name);  // of what was made
  } catch (const Error& error) {
    start_again_later(name, error.text().what + (error.text().found.empty() ? "" : ": " + error.text().found));
  }
  return fmt::format("{}", fmt::join(lines, "\n"));
}

/// As it is meant to be. What refuses to be made stays lost, with the reason; the others of its group go on. It is
/// lost until it is in its mode, which is waited for only where nothing else can be done meanwhile. Throws Error
/// Unreachable where its host is not reached.
void System::make_again(Group& target, const std::string& name) {
  if (!target.alive()) return;
  control::Load request = model_.load_of(name);
  request.set_mode(model_.instance(name).mode);
  const auto ended = [this, group = target.name(), name](const control::Reply& reply) {
    made_.push([this, group, name, reply] { made_again(group, name, reply); });
  };
  try {
    if (loads_later(request)) return bring_up(target, name, model_.instance(name), request, ended);
    create(target, name, model_.instance(name), request);
    is_back(name);
  } catch (const Error& error) {
    // On the way to another host: it is tried again once that has joined again.
    if (error.code() == ErrorCode::Unreachable && !host_of(target.name()).empty()) throw;
    if (target.alive()) lost_[name].reason = error.text().what;
  }
}

void System::is_back(const std::string& name) {
  lost_.erase(name);
  for (const auto& [client, wanted] : model_.wires()) open_again(name, port_of(client), wanted);
}

/// Unless its group has ended again meanwhile, or nobody wants it any more.
void System::made_again(const std::string& group, const std::string& name, const control::Reply& reply) {
  const auto making = making_.find({group, name});
  if (making == making_.end() || making->second.change != reply.id()) return;
  if (!reply.has_done()) {
    lost_[name].reason = reply.failure().what();
    return discard(group, name);
  }
  making_.erase(making);
  is_back(name);
}

/// What did not get to its mode, or is not wanted any more. Nobody waits for its end.
void System::discard(const std::string& group, const std::string& name) {
  made_known(group, name);
  Group* at = groups_.living(group);
  if (!at) return;
  wire::GroupRequest destroy;
  destroy.mutable_destroy()->set_instance(name);
  at->tell(std::move(destroy));
}

/// The wires of a port that begin or end at the instance.
void System::open_again(const std::string& instance, const control::PortName& client, const Model::Wire& wanted) {
  if (lost_.contains(client.instance())) return;
  const bool is_new = client.instance() == instance;
  control::Done ignored;
  const auto [first, last] = wires_.equal_range(key_of(client));
  for (auto wire = first; is_new && wire != last; ++wire) wire->second.id = 0;  // nobody knows it any more
  try {
    if (is_new && wanted.providers.size() > 1) arrange(client, wanted.providers, wanted.hold_ms, {}, model_, nullptr);
    for (auto wire = first; wire != last; ++wire) {
      const bool was_lost = wire->second.provider.instance() == instance && !wire->second.reason.empty();
      if (is_new || was_lost) wire->second = open_or_wait(client, wire->second.provider, model_, wire->second, ignored);
    }
  } catch (const Error&) {  // its process has ended meanwhile, which is noted where that is seen, or is tried again
  }
}

/// Whether a request to its process would be answered, as far as is known.
bool System::is_reached(const std::string& name) const {
  const Model::Instance* one = model_.find(name);
  if (!one || lost_.contains(name) || is_being_made(name)) return false;
  const Group* at = groups_.living(one->group);
  return at && !at->silent_since();
}

/// A wire that did not open waits for an instance that is not there, or for a process that owed an answer just then:
/// nobody tells when it has given that, so it is tried again. On virtual time the instant would be the machine's.
void System::open_waiting(std::chrono::steady_clock::time_point now) {
  if (virtual_time_ || now - opened_waiting_ < kOpensWaiting) return;
  opened_waiting_ = now;
  for (auto& [key, wire] : wires_) {
    const Model::Wire* wanted = wire.id == 0 && !wire.failed ? model_.wire_of(port_of(key)) : nullptr;
    if (!wanted || !is_reached(key.first) || !is_reached(wire.provider.instance())) continue;
    const auto [first, last] = wires_.equal_range(key);
    const bool none = std::all_of(first, last, [](const auto& one) { return one.second.id == 0; });
    try {
      if (none && wanted->providers.size() > 1)
        arrange(port_of(key), wanted->providers, wanted->hold_ms, {}, model_, nullptr);
      control::Done ignored;
      wire = connector_.connect(port_of(key), wire.provider, model_, 0, ignored);
    } catch (const Error& error) {
      wire.waits_for(error);
    }
  }
}

}  // namespace fiona::host
