// What a system has to do with other hosts, whether they lead it or are led (docs/hosts.md).
#include <fmt/format.h>

#include <algorithm>

#include "failure.hpp"
#include "system.hpp"

namespace fiona::host {

/// The host that a group is on; empty: this one.
std::string System::host_of(const std::string& group) const {
  const std::string host = group.substr(0, group.find('/'));
  return hosts_ && hosts_->peer(host) ? host : "";
}

std::string System::host_of_instance(const std::string& name) const {
  const auto* one = model_.find(name);
  return one ? host_of(one->group) : "";
}

std::vector<std::string> System::serve_hosts() {
  std::vector<std::string> said;
  if (!hosts_) return said;
  for (const auto& change : hosts_->changes()) {
    std::string line;
    if (auto fault = fault_of([&] { line = serve_host(change); })) line = *fault;
    if (!line.empty()) said.push_back(std::move(line));
  }
  return said;
}

/// What there is to tell people.
std::string System::serve_host(const HostChange& change) {
  LeaderLink* leader = hosts_->leader();
  switch (change.what) {
    case HostChange::What::Request: leader->answer(change.session, led_.obey(change.request)); break;
    case HostChange::What::Joined:
      if (!leader) return on_host_joined(change);
      if (!change.same_run) led_.destroy_all();
      model_.set_leader(change.host);
      return fmt::format("host '{}' leads this one", change.host);
    case HostChange::What::Lost:
      leader ? model_.set_leader("") : on_host_lost(change.host, change.reason, false);
      return change.reason;
    case HostChange::What::Left:
      leader->leave(change.session);
      model_.set_leader("");
      led_.destroy_all();
      break;
    case HostChange::What::GroupEnded:
      on_remote_group_ended(change);
      return fmt::format("on host '{}': {}", change.host, change.reason);
  }
  return "";
}

/// Of the leader's system, which alone may change it from here on.
void System::make_led(Model next, const std::string& name, const control::Load& request) {
  create(group_for(next.instance(name)), name, next.instance(name), request);
  model_ = std::move(next);
}

std::string System::destroy_led(const std::string& name) {
  control::Unload request;
  request.set_instance(name);
  const control::Done done = unload(request);
  model_.drop(name);
  return done.note();
}

/// What was the leader's in a group that has gone is told; the names are his to use again.
void System::forget_led(const std::string& group, const std::string& reason) {
  for (const std::string& name : model_.names_in(group)) {
    if (!model_.instance(name).led) continue;
    led_.forget(name, reason);
    lost_.erase(name);
    model_.drop(name);
  }
}

/// Whether the event is of the leader's system; if so it is told.
bool System::tell_leader(const wire::GroupMessage& event) {
  LeaderLink* leader = hosts_ ? hosts_->leader() : nullptr;
  if (!leader || !led_.is_of_leader(event)) return false;
  leader->tell(event);
  return true;
}

bool System::has_met_peers() const {
  return !hosts_ || std::ranges::all_of(hosts_->peers(), [](const auto& peer) { return peer->was_tried(); });
}

void System::add_hosts(control::System& all) {
  if (!hosts_) return;
  all.set_key(hosts_->key());
  all.set_listens(listens());
  all.set_refused_hosts(hosts_->refused());
  const auto count = [this](const auto& fits) {
    const auto names = model_.names();
    return static_cast<std::uint64_t>(std::count_if(
        names.begin(), names.end(), [&](const std::string& name) { return fits(model_.instance(name)); }));
  };
  for (const auto& peer : hosts_->peers()) {
    auto& status = *all.add_hosts() = peer->status();
    status.set_instances(count([&](const Model::Instance& one) { return host_of(one.group) == peer->peer().name; }));
  }
  if (!hosts_->leader()) return;
  if (const auto leader = hosts_->leader()->status()) {
    auto& status = *all.add_hosts() = *leader;
    status.set_instances(count([](const Model::Instance& one) { return one.led; }));
  }
}

}  // namespace fiona::host
