// The hosts that a system leads: their groups, and what is lost and found again when they go and come.
#include <fmt/format.h>

#include <utility>

#include "fiona/error.hpp"
#include "system.hpp"

namespace fiona::host {
Group& System::main_of(const std::string& host) { return group(host.empty() ? std::string(kMainGroup) : host); }

/// Null where the name is none of another host's.
Group* System::remote_group(const std::string& name) {
  const std::size_t slash = name.find('/');
  const std::string host = name.substr(0, slash);
  PeerLink* peer = hosts_ ? hosts_->peer(host) : nullptr;
  if (!peer) {
    if (slash == std::string::npos) return nullptr;
    std::vector<std::string> known;
    if (hosts_)
      for (const auto& one : hosts_->peers()) known.push_back(one->peer().name);
    throw Error(ErrorCode::NotFound,
                {.what = fmt::format("there is no host '{}'", host),
                 .expected = known.empty() ? "a host that was named with --peer when this one was started"
                                           : fmt::format("one of {}", fmt::join(known, ", ")),
                 .next = "ls hosts",
                 .near = nearest_names(host, known)});
  }
  if (!peer->joined()) {
    throw Error(ErrorCode::Unreachable, {.what = fmt::format("host '{}' is not connected", host),
                                         .where = peer->address(),
                                         .found = peer->status().reason(),
                                         .next = "ls hosts"});
  }
  const std::string group = slash == std::string::npos ? std::string(kMainGroup) : name.substr(slash + 1);
  const auto meanwhile = [this] {
    if (options_.supervisor) options_.supervisor->beat();
    watch_others();
  };
  return &groups_.put(std::make_unique<RemoteGroup>(name, *peer, group, meanwhile));
}

std::string System::on_host_joined(const HostChange& change) {
  std::string said = fmt::format("host '{}' has joined", change.host);
  if (!change.same_run) {
    on_host_lost(change.host, fmt::format("host '{}' was started anew", change.host), true);
  } else {
    const auto now = std::chrono::steady_clock::now();
    for (auto* group : groups_.of_host(change.host)) group->compare_at(now);
    for (const std::string& line : resume_groups(change.host, now)) said += "\n" + line;
  }
  for (const std::string& group : std::exchange(waiting_for_host_, {})) {
    if (host_of(group) != change.host) {
      waiting_for_host_.insert(group);
    } else if (const std::string line = start_again(group); !line.empty()) {
      said += "\n" + line;
    }
  }
  resume_wires(change.host);
  return said;
}

void System::on_host_lost(const std::string& host, const std::string& reason, bool for_good) {
  for (const std::string& name : model_.names()) {
    if (host_of_instance(name) != host) continue;
    const auto [lost, is_new] = lost_.emplace(name, Lost{});
    if (!is_new && !lost->second.away) continue;
    lost->second.reason = reason;
    lost->second.away = !for_good;
    if (is_new) tell_failed(name, reason);
  }
  for (auto& [key, wire] : wires_) {
    const bool inside = host_of_instance(key.first) == host;
    if (wire.id != 0 && (crosses(key, wire, host) || (for_good && inside))) wire.reason = reason;
  }
  if (!for_good) return;
  for (auto* group : groups_.of_host(host)) {
    group->end(reason);
    group->take_owed();
    taps_.lose(group->name(), reason);
    tell_group_ended(group->name(), reason);
  }
}

bool System::crosses(const PortKey& client, const Wire& wire, const std::string& host) {
  const std::string from = host_of_instance(client.first);
  const std::string to = host_of_instance(wire.provider.instance());
  return from != to && (from == host || to == host);
}

void System::resume_wires(const std::string& host) {
  for (auto& [key, wire] : wires_) {
    const control::PortName client = port_of(key);
    const std::string provider = wire.provider.instance();
    const bool waits_there = host_of_instance(key.first) == host || host_of_instance(provider) == host;
    const bool touched = wire.id != 0 ? crosses(key, wire, host) : waits_there;
    if (wire.reason.empty() || !touched || lost_.contains(key.first) || lost_.contains(provider)) continue;
    try {
      if (!model_.find(provider)) {
        await_provider(client, wire, model_);
        continue;
      }
      control::Done ignored;
      wire = connector_.connect(client, wire.provider, model_, wire.id, ignored, wire.id != 0);
    } catch (const Error& error) {
      leave_for_later(client, wire, error.text().what);
    }
  }
}

/// It is let go of, and opened again when both its ends are reached: nobody else would.
void System::leave_for_later(const control::PortName& client, Wire& wire, const std::string& reason) {
  const Wire old = std::exchange(wire, Wire{wire.provider, 0, false, reason, {}});
  try {
    connector_.disconnect(client, old, reason);
    await_provider(client, wire, model_);
  } catch (const Error&) {  // its end there is lost by itself
  }
}

void System::on_remote_group_ended(const HostChange& change) {
  for (auto* group : groups_.of_host(change.host)) {
    if (group->group() == change.group) lose_remote(*group, change.reason);
  }
}

void System::lose_remote(RemoteGroup& group, const std::string& reason) {
  if (!group.end().empty()) return;  // it was told twice
  group.end(reason);
  for (const std::string& name : model_.names_in(group.name())) {
    lost_[name] = {reason, false};
    tell_failed(name, reason);
  }
  taps_.lose(group.name(), reason);
  lose_wires(group.name(), reason);
  tell_group_ended(group.name(), reason);
  start_again_later(group.name(), reason);
}

}  // namespace fiona::host
