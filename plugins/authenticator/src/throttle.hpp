#pragma once

#include <algorithm>
#include <cstddef>
#include <map>
#include <optional>
#include <string>

#include "fiona/time.hpp"

namespace fiona::authenticator {

/// How many attempts a source still has: each failure takes one, and time gives them back. A success takes none,
/// and gives none back: who has an account of their own could guess at others' for ever. By source and not by user, so
/// that nobody can lock another one out.
class Throttle {
 public:
  /// Sources that are remembered; one more forgets the one that was silent the longest.
  static constexpr std::size_t kMaxSources = 4096;

  struct Rule {
    double attempts = 10;
    Duration period{};  ///< gives one attempt back
  };

  /// Takes an attempt; or says how long the source has to wait for one.
  std::optional<Duration> take(const std::string& source, TimePoint now, const Rule& rule);
  /// How many of its attempts a source has used up, as `take` left it.
  double used(const std::string& source, const Rule& rule) const {
    const auto found = sources_.find(source);
    return found == sources_.end() ? 0.0 : rule.attempts - found->second.left;
  }
  /// What `take` took: it was no failure.
  void give_back(const std::string& source, const Rule& rule) {
    const auto found = sources_.find(source);
    if (found != sources_.end()) found->second.left = std::min(rule.attempts, found->second.left + 1.0);
  }

  std::size_t sources() const { return sources_.size(); }

 private:
  struct Source {
    double left = 0;
    TimePoint at{};
  };
  std::map<std::string, Source> sources_;
};

}  // namespace fiona::authenticator
