#include "supervision.hpp"

#include <algorithm>
#include <utility>

namespace fiona::host {

std::optional<Supervision::Time> Supervision::ended(const std::string& group, Time now, std::string reason) {
  Kept& kept = groups_[group];
  kept.reason = std::move(reason);
  while (!kept.recent.empty() && now - kept.recent.front() > kWithin) kept.recent.pop_front();
  kept.due.reset();
  if (kept.recent.size() < kRestarts) kept.due = now + kPause * (1 << 2 * kept.recent.size());
  return kept.due;
}

std::vector<std::string> Supervision::take_due(Time now) {
  std::vector<std::string> due;
  for (auto& [name, kept] : groups_) {
    if (!kept.due || now < *kept.due) continue;
    kept.due.reset();
    kept.recent.push_back(now);
    ++kept.restarts;
    kept.last = Restart{now, kept.reason};
    due.push_back(name);
  }
  return due;
}

bool Supervision::waits(const std::string& group) const {
  const auto found = groups_.find(group);
  return found != groups_.end() && found->second.due;
}

bool Supervision::any_waits() const {
  return std::any_of(groups_.begin(), groups_.end(), [](const auto& one) { return one.second.due.has_value(); });
}

std::uint64_t Supervision::restarts(const std::string& group) const {
  const auto found = groups_.find(group);
  return found == groups_.end() ? 0 : found->second.restarts;
}

std::optional<Supervision::Restart> Supervision::last_restart(const std::string& group) const {
  const auto found = groups_.find(group);
  return found == groups_.end() ? std::nullopt : found->second.last;
}

}  // namespace fiona::host
