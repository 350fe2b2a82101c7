#include "throttle.hpp"

#include <algorithm>

namespace fiona::authenticator {

std::optional<Duration> Throttle::take(const std::string& source, TimePoint now, const Rule& rule) {
  auto found = sources_.find(source);
  if (found == sources_.end()) {
    if (sources_.size() >= kMaxSources) {
      sources_.erase(std::min_element(sources_.begin(), sources_.end(),
                                      [](const auto& a, const auto& b) { return a.second.at < b.second.at; }));
    }
    found = sources_.emplace(source, Source{rule.attempts, now}).first;
  }
  Source& one = found->second;
  one.left = std::min(rule.attempts, one.left + to_seconds(now - one.at) / to_seconds(rule.period));
  one.at = now;
  if (one.left < 1.0) {
    return std::chrono::duration_cast<Duration>(
        std::chrono::duration<double>((1.0 - one.left) * to_seconds(rule.period)));
  }
  one.left -= 1.0;
  return std::nullopt;
}

}  // namespace fiona::authenticator
