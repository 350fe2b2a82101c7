// The system of the host before this one, brought back: what of it still runs, and what has to be made again.
#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <iterator>
#include <set>

#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "system.hpp"

namespace fiona::host {
namespace {

/// Of a wire that is not there, until it is opened.
constexpr const char* kHostEnded = "the host has ended";

/// The end of a wire as it is meant to be, of this number unless that is 0; null: it is not in this process. Two
/// versions of an instance have wires between the same ports.
const wire::HeldWire* held_in(const ChildGroup* group, const control::PortName& client,
                              const control::PortName& provider, bool provides, std::uint64_t wire = 0) {
  if (!group || !group->adopted()) return nullptr;
  const wire::HeldWire* found = nullptr;  // an open one rather than what is left of one before it
  for (const auto& one : group->adopted()->wires()) {
    if ((provides ? one.provider_end() : one.client_end()) && !one.retired() && (wire == 0 || one.wire() == wire) &&
        key_of(one.client()) == key_of(client) && key_of(one.provider()) == key_of(provider) &&
        (!found || (one.open() && !found->open())))
      found = &one;
  }
  return found;
}

/// What a change is about: an instance, or a port that requires.
std::string subject_of(const control::Change& change) {
  using Change = control::Change;
  switch (change.what_case()) {
    case Change::kLoad: return change.load().instance().empty() ? change.load().plugin() : change.load().instance();
    case Change::kUnload: return change.unload().instance();
    case Change::kWire: return text_of(change.wire().client());
    case Change::kUnwire: return text_of(change.unwire().client());
    case Change::kSet: return change.set().instance();
    case Change::kState: return change.state().instance();
    case Change::kUpgrade: return change.upgrade().instance();
    default: return "a change";
  }
}

control::Change unload_of(const std::string& instance) {
  control::Change change;
  change.mutable_unload()->set_instance(instance);
  return change;
}

/// The system that these changes lead to, and what there is to say of what cannot be made any more: a package may have
/// gone since, or a file. Of each that somebody still wants the first reason.
std::pair<Model, std::map<std::string, std::string>> replayed(const std::vector<control::Change>& changes,
                                                              const Packages& packages) {
  Model model;
  std::map<std::string, std::string> missing;
  for (const auto& change : changes) {
    const std::string subject = subject_of(change);
    const bool begins_anew = change.has_load() || change.has_unload() || change.has_wire() || change.has_unwire();
    if (begins_anew) {
      std::erase_if(missing,
                    [&](const auto& one) { return one.first == subject || one.first.starts_with(subject + "."); });
    }
    try {
      // It was made where this one was not: it had not been brought back, or could not be taken back.
      if (change.has_load() && model.find(subject)) model.make(unload_of(subject), packages);
      model.make(change, packages);
    } catch (const Error& error) {
      const bool adds = change.has_load() || change.has_wire();
      if (change.has_unload() || change.has_unwire()) continue;
      missing.emplace(subject, fmt::format("{}'{}' is not brought back: {}", adds ? "" : "a change of ", subject,
                                           error.text().what));
    }
  }
  return {std::move(model), std::move(missing)};
}

/// What has ended a host before would end this one too: from now on it ends a group that nobody else is in. What there
/// is to say of it.
std::vector<std::string> set_apart(const std::vector<LastWords>& last_words, std::vector<control::Change>& changes) {
  std::set<std::string> groups{std::string(kMainGroup)};
  for (const auto& change : changes) groups.insert(change.load().group());
  std::vector<std::string> lines;
  for (const LastWords& words : last_words) {
    std::string group = words.instance;
    while (groups.contains(group)) group += "-apart";
    bool is_in_main = false;
    for (auto& change : changes) {
      if (!change.has_load() || subject_of(change) != words.instance) continue;
      is_in_main = change.load().group().empty() || change.load().group() == kMainGroup;
      if (is_in_main) change.mutable_load()->set_group(group);
    }
    if (!is_in_main) continue;
    groups.insert(group);
    lines.push_back(fmt::format("a host before {}: it is in a group of its own now, '{}'", words.text(), group));
  }
  return lines;
}

std::string difference_of(const control::InstanceStatus& is, const Model::Instance& wanted, const control::Load& load) {
  if (is.plugin() != wanted.package->name || is.version() != wanted.package->version ||
      is.component() != wanted.component)
    return fmt::format("'{}' is {} {} there", is.name(), is.plugin(), is.version());
  if (!wanted.is_in(is.mode()) && is.mode() != kModeFailed)
    return fmt::format("'{}' is in mode {} there", is.name(), is.mode());
  const auto same = [](const auto& a, const auto& b) { return a.SerializeAsString() == b.SerializeAsString(); };
  if (!std::equal(is.set_parameters().begin(), is.set_parameters().end(), load.parameters().begin(),
                  load.parameters().end(), same))
    return fmt::format("'{}' has other parameters there", is.name());
  return "";
}

/// One that refuses to be what it is meant to be ends alone, and is made again as one that has ended by itself.
void correct(ChildGroup& group, const std::function<void()>& correction) {
  try {
    correction();
  } catch (const Error& error) {
    group.end_now("was ended: after the host's end " + error.text().what);
  }
}

}  // namespace

std::vector<std::string> System::resume(std::vector<control::Change> changes) {
  auto apart = set_apart(options_.last_words, changes);
  auto [next, missing] = replayed(changes, packages_);
  if (next.clock().is_virtual && options_.restarts > 0) {
    options_.supervisor->quits();
    throw Error(ErrorCode::Failed, {.what = "a run on virtual time is not brought back: its end is part of the result",
                                    .found = "the host has ended: " + options_.restart_reason,
                                    .next = "fiona run --restore: the same system, from the beginning of its time"});
  }
  set_clock(next.clock());
  model_ = std::move(next);
  for (const std::string& name : model_.names()) {  // of those that go on nothing is made again that would bring them
    const Package& package = *model_.instance(name).package;
    types_.add(package.name, package.types);
  }
  auto lines = adopt_groups();
  note_wires();
  std::ranges::move(end_surplus(), std::back_inserter(lines));
  correct_ports();
  make_missing();
  std::ranges::move(finish_making(), std::back_inserter(lines));
  open_missing();
  for (const auto& [name, lost] : lost_) missing[name] = fmt::format("'{}' is not brought back: {}", name, lost.reason);
  for (auto& [subject, line] : missing) lines.push_back(std::move(line));
  std::ranges::move(apart, std::back_inserter(lines));
  return lines;
}

/// Empty: it holds what the system is meant to have there. What it holds beside that is no reason to end the rest,
/// unless it would keep the process busy.
std::string System::difference_from(const ChildGroup& group) const {
  const auto& there = group.adopted()->status().instances();
  const auto names = model_.names_in(group.name());
  for (const std::string& name : names) {
    const auto found = std::find_if(there.begin(), there.end(), [&](const auto& one) { return one.name() == name; });
    if (found == there.end()) return fmt::format("'{}' is not there", name);
    const auto difference = difference_of(*found, model_.instance(name), model_.load_of(name));
    if (!difference.empty()) return difference;
  }
  const auto moves = std::find_if(there.begin(), there.end(), [](const auto& one) { return one.has_pending(); });
  if (moves != there.end()) return fmt::format("'{}' is about to change its mode", moves->name());
  const auto wanted = confinement_of_group(first_in(group.name()), group.folder());
  const bool same = wanted.SerializeAsString() == group.confinement().SerializeAsString();
  return names.empty() ? "nothing is meant to be there" : same ? "" : "it is meant to have other rights";
}

/// One that cannot be adopted ends alone. The wires of the others to one that is gone end before any are opened.
std::vector<std::string> System::adopt_groups() {
  std::vector<std::string> lines;
  std::vector<std::unique_ptr<ChildGroup>> asked;
  std::map<std::string, std::string> gone;  // how, by endpoint
  for (KeptGroup& kept : std::exchange(kept_, {})) {
    const wire::KeptGroup told = kept.told;
    const std::string name = told.name();
    const pid_t process = kept.process;
    try {
      const ChildGroup::Start start = start_of_group(told.name(), nullptr, told.folder());
      asked.push_back(std::make_unique<ChildGroup>(std::move(kept), start, [this, name](wire::GroupMessage event) {
        deliver_from_child(name, std::move(event));
      }));
    } catch (const Error& error) {
      options_.supervisor->drop(process);  // who ends what is not kept
      std::error_code ignored;
      std::filesystem::remove_all(told.folder(), ignored);
      lines.push_back(gone[told.endpoint()] = fmt::format("group '{}' was ended: {}", name, error.text().what));
    }
  }
  const auto deadline = std::chrono::steady_clock::now() + kAdoptionDeadline;
  for (auto& group : asked) {
    const std::string name = group->name();
    group->finish_adoption(deadline);
    if (group->alive()) {
      if (const auto difference = difference_from(*group); !difference.empty())
        group->end_now("was ended: after the host's end " + difference);
    }
    if (group->alive()) {
      lines.push_back(fmt::format("group '{}' goes on", name));
      groups_.put(std::move(group));
    } else {
      lines.push_back(gone[group->endpoint()] = fmt::format("group '{}' {}", name, group->end()));
    }
  }
  for (const auto& [endpoint, reason] : gone) groups_.tell_ended(endpoint, reason);
  return lines;
}

/// What groups that go on hold beside what they are meant to: the version before an upgrade, or the one after it that
/// was not to be yet; what was about to be loaded. Nothing stands by for a host that did not see it begin to.
std::vector<std::string> System::end_surplus() {
  std::vector<std::string> lines;
  for (auto* child : child_groups()) {
    for (const auto& one : child->adopted()->status().instances()) {
      const auto* meant = model_.find(one.name());
      if (meant && meant->group == child->name()) continue;
      lines.push_back(fmt::format("'{}' {} is ended in group '{}', where it is not meant to be", one.name(),
                                  one.version(), child->name()));
      set_beside(child->name(), one.name(), meant != nullptr);
      Beside left{.name = one.name()};
      left.made.group = child->name();
      destroy_version(left);
    }
  }
  return lines;
}

/// Those that are open at both ends stay; whatever else groups hold of wires is cut.
void System::note_wires() {
  std::set<std::uint64_t> kept;
  const auto group_of_name = [this](const std::string& instance) -> ChildGroup* {
    const auto* one = model_.find(instance);
    return one ? groups_.child(one->group) : nullptr;
  };
  for (const auto& [key, wanted] : model_.wires()) {
    const control::PortName client = port_of(key);
    for (const auto& provider : wanted.providers) {
      const auto* ours = held_in(group_of_name(client.instance()), client, provider, false);
      const auto* theirs =
          ours ? held_in(group_of_name(provider.instance()), client, provider, true, ours->wire()) : nullptr;
      Wire wire{provider, ours ? ours->wire() : 0, ours && ours->provider_end(), kHostEnded, {}};
      const bool is_open = theirs && ours->open() && theirs->open() && theirs->prescale() == wanted.prescale;
      if (is_open) wire.reason.clear();
      if (ours) kept.insert(ours->wire());
      wires_.emplace(key, std::move(wire));
    }
  }
  for (auto* child : child_groups()) {
    for (const auto& one : child->adopted()->wires()) {
      connector_.number_from(one.wire() + 1);
      if (kept.contains(one.wire()) || one.retired()) continue;
      correct(*child, [&] { groups_.cut(child->name(), one.wire(), kHostEnded); });
    }
  }
}

/// In the order of their loading, each in its group; they are on their way to their modes then.
void System::make_missing() {
  std::map<std::uint64_t, std::string> ordered;
  for (const std::string& name : model_.names()) {
    const auto& one = model_.instance(name);
    const ChildGroup* child = groups_.child(one.group);
    if (child && child->adopted()) continue;
    ordered[one.order] = name;
    lost_[name].reason = kHostEnded;
  }
  for (const auto& [order, name] : ordered) {
    if (options_.supervisor) options_.supervisor->beat();
    settle();
    const std::string at = model_.instance(name).group;
    lose_if_gone(at);
    if (supervision_.waits(at)) continue;  // it has ended of what was made in it
    try {
      Group& target = group(at);
      make_again(target, name);
      lose_if_gone(at);
    } catch (const Error& error) {
      start_again_later(at, error.text().what);
    }
  }
}

/// Until each is in its mode, or has failed to get there, for which it has its time. What groups say is heard
/// meanwhile.
std::vector<std::string> System::finish_making() {
  std::vector<std::string> lines;
  while (!making_.empty()) {
    if (options_.supervisor) options_.supervisor->beat();
    const auto children = child_groups();
    std::vector<pollfd> waits{{made_.descriptor(), POLLIN, 0}};
    for (const auto* child : children) waits.push_back({child->descriptor(), POLLIN, 0});
    if (::poll(waits.data(), waits.size(), static_cast<int>(kWatchEvery.count())) < 0) continue;
    for (std::size_t i = 0; i < children.size(); ++i) {
      if (waits[i + 1].revents != 0) serve_group(*children[i]);
    }
    std::ranges::move(watch_groups(), std::back_inserter(lines));
  }
  return lines;
}

/// A change that was under way may have left a port with alternatives, or waiting, that is to have one wire or none.
void System::correct_ports() {
  for (auto* child : child_groups()) {
    if (!child->adopted()) continue;
    correct(*child, [&] { correct_ports(child->name(), child->adopted()->status()); });
  }
}

void System::correct_ports(const std::string& group, const wire::GroupStatusReply& there) {
  for (const auto& instance : there.instances()) {
    const auto* meant = model_.find(instance.name());
    if (!meant || meant->group != group || lost_.contains(instance.name())) continue;  // it is on its way out, or in
    for (const auto& port : instance.ports()) {
      if (port.direction() != REQUIRES) continue;
      const control::PortName client = port_of({instance.name(), port.name()});
      const Model::Wire* wanted = model_.wire_of(client);
      const auto listed = [](const auto& one, const auto& is) { return key_of(one) == key_of(is.provider()); };
      const bool is_so = !wanted ? port.connection() == control::UNWIRED
                         : wanted->providers.size() == 1
                             ? port.providers_size() == 0
                             : std::equal(wanted->providers.begin(), wanted->providers.end(), port.providers().begin(),
                                          port.providers().end(), listed);
      if (is_so) continue;
      const Model::Wire as_meant = wanted ? *wanted : Model::Wire{};
      arrange(client, as_meant.providers, as_meant.hold_ms, {}, model_, nullptr);
    }
  }
}

void System::open_missing() {
  for (const auto& [key, wanted] : model_.wires()) {
    const control::PortName client = port_of(key);
    if (lost_.contains(client.instance())) continue;
    settle();
    try {
      if (wanted.providers.size() > 1) arrange(client, wanted.providers, wanted.hold_ms, {}, model_, nullptr);
      for (auto [wire, last] = wires_.equal_range(key); wire != last; ++wire) {
        control::Done ignored;
        if (!wire->second.reason.empty())
          wire->second = open_or_wait(client, wire->second.provider, model_, wire->second, ignored);
      }
    } catch (const Error&) {  // its process has ended meanwhile, which is noted where that is seen
    }
  }
}

}  // namespace fiona::host
