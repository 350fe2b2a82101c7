#include "group_subjects.hpp"

#include <fmt/format.h>

#include <bit>
#include <iostream>

namespace fiona::host {
namespace {

/// Changes of mode and calls by hand whose end is not told. The end of one may be lost on its way from another host, or
/// never come; who has waited has been told so long ago.
constexpr std::size_t kMostLater = 100'000;

}  // namespace

void GroupSubjects::ask(const wire::GroupRequest& request) {
  if (Then then = following(request)) open_[request.id()] = std::move(then);
}

GroupSubjects::Then GroupSubjects::unless_refused(Numbers& numbers, std::uint64_t number) {
  if (number != 0) numbers.insert(number);
  return [&numbers, number](bool done) {
    if (!done) numbers.erase(number);
  };
}

/// Of what ends after the answer. Of too many the oldest is forgotten.
GroupSubjects::Then GroupSubjects::later(Numbers& numbers, std::uint64_t number) {
  if (numbers.size() >= kMostLater) numbers.erase(numbers.begin());
  return unless_refused(numbers, number);
}

GroupSubjects::Then GroupSubjects::following(const wire::GroupRequest& request) {
  using Request = wire::GroupRequest;
  const auto leaves = [this](const std::string& name, bool when) {
    return [this, name, when](bool done) {
      if (const auto one = instances_.find(name); done == when && one != instances_.end()) instances_.erase(one);
    };
  };
  switch (request.what_case()) {
    case Request::kCreate:
      instances_.insert(request.create().instance());
      return [left = leaves(request.create().instance(), false),
              changed = later(changes_, request.create().change())](bool done) {
        left(done);
        changed(done);
      };
    case Request::kDestroy: return leaves(request.destroy().instance(), true);
    case Request::kWireLocal:
      wires_.insert(request.wire_local().wire());
      return [this, now = request.wire_local().wire(), old = request.wire_local().replaces()](bool done) {
        wires_.erase(done ? old : now);
      };
    case Request::kWireRequire:
      wires_.insert(request.wire_require().wire());
      return [this, now = request.wire_require().wire(), old = request.wire_require().replaces()](bool done) {
        wires_.erase(done ? old : now);
      };
    case Request::kWireProvide:
      if (!request.wire_provide().attached()) return nullptr;
      return unless_refused(wires_, request.wire_provide().wire());
    case Request::kCut: return [this, wire = request.cut().wire()](bool) { wires_.erase(wire); };
    case Request::kArrange:
      return [this, retired = request.arrange().retires()](bool done) {
        if (!done) return;
        for (const std::uint64_t wire : retired) wires_.erase(wire);
      };
    case Request::kTap: return unless_refused(taps_, request.tap().tap());
    case Request::kUntap: return [this, tap = request.untap().tap()](bool) { taps_.erase(tap); };
    case Request::kSetMode: return later(changes_, request.set_mode().change());
    case Request::kCall: return later(calls_, request.call().run());
    default: return nullptr;
  }
}

void GroupSubjects::answered(const wire::GroupMessage& reply) {
  const auto then = open_.extract(reply.id());
  if (!then.empty()) then.mapped()(!reply.has_failure());
}

void GroupSubjects::hold(const wire::Adopted& adopted) {
  for (const auto& one : adopted.status().instances()) instances_.insert(one.name());
  for (const auto& one : adopted.wires()) {
    if (one.client_end()) wires_.insert(one.wire());
  }
}

void GroupSubjects::keep(const wire::Adopted& held) {
  std::set<std::string> names;
  Numbers wires;
  for (const auto& one : held.status().instances()) names.insert(one.name());
  for (const auto& one : held.wires()) {
    if (one.client_end()) wires.insert(one.wire());
  }
  std::erase_if(instances_, [&](const auto& one) { return !names.contains(one); });
  std::erase_if(wires_, [&](const auto& one) { return !wires.contains(one); });
}

bool GroupSubjects::is_empty() const {
  return instances_.empty() && wires_.empty() && taps_.empty() && changes_.empty() && calls_.empty() && open_.empty();
}

bool GroupSubjects::take(const wire::GroupMessage& event) {
  using Event = wire::GroupMessage;
  switch (event.what_case()) {
    case Event::kModeChanged: return instances_.contains(event.mode_changed().instance());
    case Event::kRunEnded: return instances_.contains(event.run_ended().instance());
    case Event::kLogged: return instances_.contains(event.logged().instance());
    case Event::kAsked: return instances_.contains(event.asked().instance());
    case Event::kTapped: return taps_.contains(event.tapped().tap());
    case Event::kTapEnded: return taps_.contains(event.tap_ended().tap());
    case Event::kWireLost: return wires_.contains(event.wire_lost().wire());
    case Event::kModeSet: return changes_.erase(event.mode_set().change()) > 0;
    case Event::kCallEnded: return calls_.erase(event.call_ended().run()) > 0;
    default: return false;
  }
}

void Disbelief::tell(const std::string& who, const wire::GroupMessage& event) {
  if (!std::has_single_bit(++times_)) return;
  const auto* what = wire::GroupMessage::descriptor()->FindFieldByNumber(event.what_case());
  std::cerr << fmt::format(
      "{} has spoken of what it does not have, and was not asked for ({}): that is not believed; so far: {}\n", who,
      what ? what->name() : "nothing", times_);
}

}  // namespace fiona::host
