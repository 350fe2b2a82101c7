// The way from one system to another.
#include <map>
#include <optional>
#include <set>

#include "fiona/params.hpp"
#include "model.hpp"

namespace fiona::host {
namespace {

/// Whether one can become the other without being loaded anew.
bool is_same(const Model::Instance& a, const Model::Instance& b) {
  return a.package == b.package && a.component == b.component && a.group == b.group && a.rights == b.rights;
}

/// Of the instances of two systems: those that go over as they are, and the others in the order of their loading.
struct Passage {
  std::set<std::string> kept;
  std::map<std::uint64_t, std::string> leaving;
  std::map<std::uint64_t, std::string> coming;
};

/// `keeps`: not where another clock comes, which takes all who lived by the one before with it.
Passage passage_between(const Model& from, const Model& to, bool keeps) {
  Passage passage;
  for (const std::string& name : from.names()) {
    const Model::Instance& one = from.instance(name);
    if (one.led) continue;
    const Model::Instance* same = to.find(name);
    if (keeps && same && is_same(one, *same)) {
      passage.kept.insert(name);
    } else {
      passage.leaving[one.order] = name;
    }
  }
  for (const std::string& name : to.names()) {
    const Model::Instance& one = to.instance(name);
    if (!passage.kept.contains(name) && !one.led) passage.coming[one.order] = name;
  }
  return passage;
}

/// Of an instance that is in both.
std::optional<control::Change> parameters_between(const Model& from, const Model& to, const std::string& name) {
  const Model::Instance& target = to.instance(name);
  if (!target.parameters) return std::nullopt;
  auto different = differences(*target.parameters, *from.instance(name).parameters);
  if (different.empty()) return std::nullopt;
  control::Change change;
  change.mutable_set()->set_instance(name);
  for (auto& one : different) *change.mutable_set()->add_parameters() = std::move(one);
  return change;
}

control::Change state_of(const std::string& name, const std::string& mode) {
  control::Change change;
  change.mutable_state()->set_instance(name);
  change.mutable_state()->set_mode(mode);
  return change;
}

}  // namespace

std::vector<control::Change> Model::difference(const Model& from, const Model& to) {
  const auto [kept, leaving, coming] = passage_between(from, to, !to.clock_.is_another_than(from.clock_));
  std::vector<control::Change> steps;
  for (const auto& [client, wire] : from.wires_) {
    const bool goes = kept.contains(client.first) && !to.wires_.contains(client);
    if (goes) *steps.emplace_back().mutable_unwire()->mutable_client() = port_of(client);
  }
  for (auto it = leaving.rbegin(); it != leaving.rend(); ++it)
    steps.emplace_back().mutable_unload()->set_instance(it->second);
  if (from.clock_ != to.clock_) steps.push_back(to.clock_.change_from(from.clock_));
  // A wire that waits for a name keeps out who has it and does not fit: it goes before that one comes.
  std::set<PortKey> rewired;
  for (const auto& [client, wire] : from.wires_) {
    const auto next = to.wires_.find(client);
    if (!kept.contains(client.first) || next == to.wires_.end() || !to.keeps_out(client, wire)) continue;
    steps.push_back(next->second.change_for(client, &wire));
    rewired.insert(client);
  }
  for (const auto& [order, name] : coming) *steps.emplace_back().mutable_load() = to.load_of(name);
  for (const auto& name : kept) {
    if (auto change = parameters_between(from, to, name)) steps.push_back(std::move(*change));
  }
  for (const auto& [client, wire] : to.wires_) {
    const auto old = from.wires_.find(client);
    const Wire* before = kept.contains(client.first) && old != from.wires_.end() ? &old->second : nullptr;
    const bool there = before && *before == wire;
    if (!there && !rewired.contains(client)) steps.push_back(wire.change_for(client, before));
  }
  for (const auto& [name, one] : to.instances_) {
    if (one->led) continue;
    const std::string before = kept.contains(name) ? from.instance(name).mode : one->mode_after_load();
    if (before != one->mode) steps.push_back(state_of(name, one->mode));
  }
  return steps;
}

}  // namespace fiona::host
