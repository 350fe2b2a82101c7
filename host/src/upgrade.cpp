#include "upgrade.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "fiona/hull.hpp"

namespace fiona::host {

std::optional<std::string> Deliveries::note(const wire::GroupMessage& event) {
  if (event.has_mode_changed() && event.mode_changed().instance() == name_ &&
      event.mode_changed().mode() == kModeFailed)
    return event.mode_changed().reason();
  if (event.has_tapped() && !event.tapped().type().empty()) ++heard_[event.tapped().tap()];
  if (!event.has_tap_ended()) return std::nullopt;
  const auto is_its = [&](const Pair& pair) { return pair.tap == event.tap_ended().tap(); };
  if (std::none_of(pairs_.begin(), pairs_.end(), is_its)) return std::nullopt;
  return event.tap_ended().failure().what();
}

bool Deliveries::all() const {
  return std::all_of(pairs_.begin(), pairs_.end(), [&](const Pair& pair) { return heard_.contains(pair.tap); });
}

std::optional<std::string> Deliveries::missing() const {
  for (const Pair& pair : pairs_) {
    const auto before = heard_.find(pair.before);
    if (heard_.contains(pair.tap) || (pair.before != 0 && before == heard_.end())) continue;
    return pair.before == 0
               ? fmt::format("its port {} has fallen silent", pair.port)
               : fmt::format("its port {} says nothing, where the one before said {} times something meanwhile",
                             pair.port, before->second);
  }
  return std::nullopt;
}

}  // namespace fiona::host
