// Groups whose process has ended are started again, with all that they are meant to hold.
#include <fmt/format.h>

#include "fiona/error.hpp"
#include "system.hpp"

namespace fiona::host {

/// Of a run on virtual time the end of a process is part of the result: it is not mended.
void System::start_again_later(const std::string& group, const std::string& reason) {
  if (!options_.restarts_groups || virtual_time_) return;
  const auto lost = lost_in(group);
  if (lost.empty()) return;
  const bool again = supervision_.ended(group, std::chrono::steady_clock::now()).has_value();
  for (const auto& [order, name] : lost) {
    lost_[name].reason = again ? reason + "; it is started again"
                               : fmt::format("{}; left, after {} restarts within {} s", reason, Supervision::kRestarts,
                                             Supervision::kWithin.count());
  }
}

/// This system's own instances that ended with their group, in the order of their loading.
std::map<std::uint64_t, std::string> System::lost_in(const std::string& group) const {
  std::map<std::uint64_t, std::string> ordered;
  for (const std::string& name : model_.names_in(group)) {
    const auto lost = lost_.find(name);
    const Model::Instance& one = model_.instance(name);
    if (lost != lost_.end() && !lost->second.away && !one.led) ordered[one.order] = name;
  }
  return ordered;
}

std::string System::start_again(const std::string& name) {
  const auto lost = lost_in(name);
  if (lost.empty()) {
    supervision_.forget(name);
    return "";
  }
  const std::string line = fmt::format("group '{}' is started again: {}", name, lost_[lost.begin()->second].reason);
  try {
    Group& target = group(name);
    for (const auto& [order, instance] : lost) make_again(target, instance);
    // It may have ended of what was made.
    if (!target.alive()) {
      lose_if_gone(name);
      return line;
    }
  } catch (const Error& error) {
    start_again_later(name, error.text().what + (error.text().found.empty() ? "" : ": " + error.text().found));
    return line;
  }
  for (const auto& [client, wanted] : model_.wires()) open_again(name, port_of(client), wanted);
  return line;
}

/// As it is meant to be. What refuses to be made stays lost, with the reason; the others of its group go on.
void System::make_again(Group& target, const std::string& name) {
  if (!target.alive()) return;
  control::Load request = model_.load_of(name);
  request.set_mode(model_.instance(name).mode);
  try {
    create(target, name, model_.instance(name), request);
    lost_.erase(name);
  } catch (const Error& error) {
    if (target.alive()) lost_[name].reason = error.text().what;
  }
}

/// The wires of a port that begin or end in the group.
void System::open_again(const std::string& group, const control::PortName& client, const Model::Wire& wanted) {
  if (lost_.contains(client.instance())) return;
  const bool is_new = model_.instance(client.instance()).group == group;
  control::Done ignored;
  try {
    if (is_new && wanted.providers.size() > 1) arrange(client, wanted.providers, wanted.hold_ms, {}, model_, nullptr);
    const auto [first, last] = wires_.equal_range(key_of(client));
    for (auto wire = first; wire != last; ++wire) {
      const Model::Instance* provider = model_.find(wire->second.provider.instance());
      const bool was_lost = provider && provider->group == group && !wire->second.reason.empty();
      if (is_new) wire->second.id = 0;  // nobody knows it any more
      if (is_new || was_lost) wire->second = open_or_wait(client, wire->second.provider, model_, wire->second, ignored);
    }
  } catch (const Error&) {  // its process has ended meanwhile, which is noted where that is seen
  }
}

}  // namespace fiona::host
