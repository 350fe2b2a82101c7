#include "groups.hpp"

#include "fiona/error.hpp"
#include "names.hpp"

namespace fiona::host {

Group* Groups::find(const std::string& name) const {
  const auto found = groups_.find(name);
  return found == groups_.end() ? nullptr : found->second.get();
}

Group* Groups::living(const std::string& name) const {
  Group* found = find(name);
  return found && found->alive() ? found : nullptr;
}

ChildGroup* Groups::child(const std::string& name) const { return dynamic_cast<ChildGroup*>(find(name)); }

MainGroup& Groups::main() const { return dynamic_cast<MainGroup&>(*groups_.at(std::string(kMainGroup))); }

std::vector<RemoteGroup*> Groups::of_host(const std::string& host) const {
  std::vector<RemoteGroup*> found;
  for (const auto& [name, one] : groups_) {
    auto* remote = dynamic_cast<RemoteGroup*>(one.get());
    if (remote && remote->host() == host) found.push_back(remote);
  }
  return found;
}

RemoteGroup* Groups::silent(const std::string& name) const {
  auto* remote = dynamic_cast<RemoteGroup*>(find(name));
  return remote && remote->end().empty() && !remote->alive() ? remote : nullptr;
}

Group& Groups::put(std::unique_ptr<Group> group) {
  auto& place = groups_[group->name()];
  if (place) retired_.push_back(std::move(place));
  return *(place = std::move(group));
}

void Groups::retire(const std::string& name) { retired_.push_back(std::move(groups_.extract(name).mapped())); }

void Groups::end_all() {
  groups_.clear();
  retired_.clear();
}

void Groups::cut(const std::string& name, std::uint64_t wire, const std::string& reason) {
  Group* group = find(name);
  if (!group) return;
  wire::GroupRequest cut;
  cut.mutable_cut()->set_wire(wire);
  cut.mutable_cut()->set_reason(reason);
  auto* remote = dynamic_cast<RemoteGroup*>(group);
  if (!remote) {
    if (group->alive()) group->inform(std::move(cut));
    return;
  }
  if (!remote->end().empty()) return;
  try {
    remote->request(cut);
  } catch (const Error& error) {
    if (!remote->alive()) return remote->owe(std::move(cut));
    if (error.code() != ErrorCode::Unreachable) throw;  // it has it before it
  }
}

void Groups::tell_lost(const wire::PeerLost& lost) {
  for (const auto& [name, one] : groups_) {
    if (one->endpoint() != lost.endpoint() && one->alive()) one->peer_lost(lost);
  }
}

void Groups::tell_ended(const std::string& endpoint, const std::string& reason) {
  wire::PeerLost lost;
  lost.set_endpoint(endpoint);
  lost.set_name(endpoint);
  lost.set_reason(reason);
  tell_lost(lost);
}

}  // namespace fiona::host
