// What a led host has, compared with what it is meant to have: when it joins again, and when it has left something
// unanswered. What was asked of it and not answered may have been done or not; the system here is as before.
#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "failure.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/params.hpp"
#include "system.hpp"

namespace fiona::host {
namespace {

using Steady = std::chrono::steady_clock;

/// A host that is there and does not say what it has is asked again so much later: who asks it waits.
constexpr std::chrono::seconds kAskAgain{5};
/// A change of mode that is being made has been noted here by then.
constexpr std::chrono::seconds kNoted{1};
constexpr double kCorrection_ms = 11'000;

constexpr const char* kNotThere = "the wire was not there any more";

/// What it was asked for while its host was silent. What it refuses is gone already.
void pay_owed(RemoteGroup& group) {
  for (auto& request : group.take_owed()) {
    try {
      group.request(request);
    } catch (const Error&) {
      if (!group.alive()) group.owe(std::move(request));
    }
  }
}

bool has_instance(const wire::Adopted& held, const std::string& name) {
  const auto& all = held.status().instances();
  return std::any_of(all.begin(), all.end(), [&](const auto& one) { return one.name() == name; });
}

bool is_client_end(const wire::HeldWire& one) { return one.client_end() && !one.retired(); }

/// What is to be set so that it has these.
std::vector<control::Argument> missing_in(const control::InstanceStatus& is, const Model::Instance& meant) {
  if (!meant.parameters) return {};
  const auto there = meant.default_parameters();
  set_fields(*there, std::vector<control::Argument>(is.set_parameters().begin(), is.set_parameters().end()));
  return differences(*meant.parameters, *there);
}

}  // namespace

/// Those of a host whose time has come: what is lost of them first, then what is left as it is meant to be.
std::vector<std::string> System::resume_groups(const std::string& host, Steady::time_point due) {
  std::vector<std::string> lines;
  std::vector<std::pair<RemoteGroup*, wire::Adopted>> told;
  for (auto* group : groups_.of_host(host)) {
    if (!group->end().empty() || !group->compares_at() || *group->compares_at() > due) continue;
    if (auto held = resume(*group, lines)) told.emplace_back(group, std::move(*held));
  }
  for (const auto& [group, held] : told) make_agree(*group, held, lines);
  return lines;
}

/// Hosts that have left something unanswered: what they hold that was away is away until they tell.
std::vector<std::string> System::resume_late(Steady::time_point now) {
  std::vector<std::string> lines;
  if (!hosts_) return lines;
  for (const auto& peer : hosts_->peers()) {
    const auto groups = groups_.of_host(peer->peer().name);
    const auto is_due = [now](const auto* group) {
      return group->alive() && group->compares_at() && *group->compares_at() <= now;
    };
    if (std::none_of(groups.begin(), groups.end(), is_due)) continue;
    std::ranges::move(resume_groups(peer->peer().name, now), std::back_inserter(lines));
    resume_wires(peer->peer().name);
  }
  return lines;
}

/// Does what was asked for meanwhile, and finds out what is still there; none: it does not tell now, or has ended.
std::optional<wire::Adopted> System::resume(RemoteGroup& group, std::vector<std::string>& lines) {
  group.is_compared();
  pay_owed(group);
  wire::Adopted held;
  try {
    wire::GroupRequest ask;
    ask.mutable_inventory();
    held = group.request(std::move(ask)).adopted();
  } catch (const Error& error) {
    if (error.code() != ErrorCode::Unreachable) lines.push_back(error.text().what);
    if (group.alive()) group.compare_at(Steady::now() + kAskAgain);
    return std::nullopt;
  }
  for (const std::string& name : model_.names_in(group.name())) {
    const auto lost = lost_.find(name);
    const bool is_known = lost != lost_.end() && !lost->second.away;
    if (is_known || has_instance(held, name)) continue;
    if (const auto ended = held.ended().find(name); ended != held.ended().end()) {
      lose_remote(group, ended->second);
      lines.push_back(fmt::format("on host '{}': {}", group.host(), ended->second));
      return std::nullopt;
    }
    const std::string reason = fmt::format("it was unloaded on host '{}'", group.host());
    lost_[name] = {reason, false};
    if (lost == lost_.end()) tell_failed(name, reason);
  }
  for (const auto& one : held.status().instances()) {
    const auto* known = model_.find(one.name());
    const auto lost = lost_.find(one.name());
    if (lost != lost_.end() && lost->second.away && known && known->group == group.name()) {
      lost_.erase(lost);
      if (one.mode() == kModeFailed) tell_failed(one.name(), one.reason());  // perhaps while nobody could hear it
    }
    if (known && known->group == group.name() && !lost_.contains(one.name())) continue;
    // Made by a request whose answer was lost.
    wire::GroupRequest destroy;
    destroy.mutable_destroy()->set_instance(one.name());
    group.owe(std::move(destroy));
  }
  pay_owed(group);
  return held;
}

/// What cannot be made so is told; where it does not answer it is compared again.
void System::make_agree(RemoteGroup& group, const wire::Adopted& held, std::vector<std::string>& lines) {
  const auto attempt = [&lines](const std::function<void()>& work) {
    if (auto fault = fault_of(work)) lines.push_back(std::move(*fault));
  };
  for (const auto& one : held.status().instances()) {
    const auto* known = model_.find(one.name());
    if (!known || known->group != group.name() || lost_.contains(one.name())) continue;
    if (one.mode() == kModeFailed) continue;
    attempt([&] { correct_parameters(group, one, lines); });
    attempt([&] { correct_mode(group, one, lines); });
  }
  std::erase_if(strayed_, [this](const auto& one) { return !model_.find(one.first) || lost_.contains(one.first); });
  attempt([&] { correct_wires(group, held, lines); });
  attempt([&] { correct_ports(group.name(), held.status()); });
}

void System::correct_parameters(RemoteGroup& group, const control::InstanceStatus& is,
                                std::vector<std::string>& lines) {
  const auto missing = missing_in(is, model_.instance(is.name()));
  if (missing.empty()) return;
  wire::GroupRequest request;
  request.mutable_set_parameters()->set_instance(is.name());
  request.mutable_set_parameters()->mutable_parameters()->Add(missing.begin(), missing.end());
  group.request(std::move(request));
  lines.push_back(fmt::format("'{}' has its parameters again: host '{}' had set others", is.name(), group.host()));
}

/// One that has just been reached may be a change that was asked for, and is not noted here yet: it is looked at again.
void System::correct_mode(RemoteGroup& group, const control::InstanceStatus& is, std::vector<std::string>& lines) {
  const std::string& name = is.name();
  const std::string wanted = model_.instance(name).mode;
  if (model_.instance(name).is_in(is.mode())) {
    strayed_.erase(name);
    return;
  }
  const auto now = Steady::now();
  if (changing_.contains(name)) {  // whoever has asked is told, and what is meant follows from that
    strayed_.erase(name);
    return group.compare_at(now + kNoted);
  }
  const auto [strayed, is_new] = strayed_.emplace(name, now);
  const bool has_changed = is.has_pending() || is.mode_since_s() < to_seconds(now - strayed->second);
  if (is_new || has_changed || now - strayed->second < kNoted) {
    if (has_changed) strayed->second = now;
    return group.compare_at(now + kNoted);
  }
  strayed_.erase(strayed);
  const std::uint64_t change = next_work_++;
  const auto begin = [&] { group.request(mode_request(name, wanted, change)); };
  const auto ended = [this](const control::Reply& reply) {
    if (reply.has_failure()) made_.push([reply] { throw_failure(reply.failure()); });
  };
  const auto expired = failure_reply(
      ErrorCode::Unreachable,
      {.what = fmt::format("'{}' did not go back to mode {}", name, wanted), .where = name, .next = "show " + name});
  waits_->work(kNobody, change, kCorrection_ms, begin, end_of_mode(change), expired, ended);
  lines.push_back(
      fmt::format("'{}' goes back to mode {}: host '{}' had brought it to {}", name, wanted, group.host(), is.mode()));
}

/// By the clients' ends: whoever has one is told the end of the other.
void System::correct_wires(RemoteGroup& group, const wire::Adopted& held, std::vector<std::string>& lines) {
  const auto attempt = [&lines](const std::function<void()>& work) {
    if (auto fault = fault_of(work)) lines.push_back(std::move(*fault));
  };
  std::map<std::uint64_t, std::pair<const PortKey, Wire>*> known;
  for (auto& one : wires_) {
    if (one.second.id != 0) known[one.second.id] = &one;
  }
  std::set<std::uint64_t> there;
  std::set<std::string> failed;  // whose wires are lost, and stay so
  for (const auto& one : held.status().instances()) {
    if (one.mode() == kModeFailed) failed.insert(one.name());
  }
  for (const auto& one : held.wires()) {
    const auto ours = known.find(one.wire());
    if (is_client_end(one) && ours == known.end()) attempt([&] { take_back_wire(group, one, lines); });
    if (is_client_end(one) && one.open()) there.insert(one.wire());
    if (!one.provider_end() || ours == known.end() || ours->second->second.id != one.wire()) continue;
    const std::uint32_t prescale = model_.wire_of(port_of(ours->second->first))->prescale;
    if (one.prescale() == prescale) continue;
    attempt([&] { group.request(prescaled(one.wire(), prescale)); });
  }
  for (auto& [key, wire] : wires_) {
    const auto* client = model_.find(key.first);
    if (!client || client->group != group.name() || lost_.contains(key.first)) continue;
    if (failed.contains(key.first)) {
      if (wire.is_open() && !there.contains(wire.id)) wire.reason = "'" + key.first + "' has failed";
      continue;
    }
    if (wire.id == 0) await_provider(port_of(key), wire, model_);
    // One that was opened here, in the place of what was found, is not what it has told.
    if (!wire.is_open() || there.contains(wire.id) || !known.contains(wire.id)) continue;
    leave_for_later(port_of(key), wire, kNotThere);
    lines.push_back(fmt::format("{}: {}", text_of(port_of(key)), kNotThere));
  }
}

/// A wire that nobody here knows has taken the place of the one that is meant to be.
void System::take_back_wire(RemoteGroup& group, const wire::HeldWire& found, std::vector<std::string>& lines) {
  const PortKey key = key_of(found.client());
  const Model::Wire* wanted = model_.wire_of(found.client());
  const auto meant = wires_.find(key);
  const bool is_single = wanted && wanted->providers.size() == 1 && meant != wires_.end();
  std::string why = "it was not wired so";
  if (is_single && model_.find(meant->second.provider.instance())) {
    try {
      control::Done ignored;
      meant->second = connector_.connect(found.client(), meant->second.provider, model_, found.wire(), ignored);
      lines.push_back(fmt::format("{} is wired to {} again: host '{}' had wired it to {}", text_of(found.client()),
                                  text_of(meant->second.provider), group.host(), text_of(found.provider())));
      return;
    } catch (const Error& error) {
      why = error.text().what;
    }
  }
  groups_.cut(group.name(), found.wire(), why);
  if (is_single) leave_for_later(found.client(), meant->second, why);
}

}  // namespace fiona::host
