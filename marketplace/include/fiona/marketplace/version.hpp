#pragma once

#include <compare>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::marketplace {

/// A semantic version 2.0.0 (semver.org). Ordered by precedence: a pre-release comes before its release,
/// numbers compare as numbers of any length, and build metadata ("+…") does not count, so 1.0.0+a and 1.0.0+b
/// are equal.
class Version {
 public:
  /// Nothing if `text` is not a semantic version of at most 64 characters.
  static std::optional<Version> parse(std::string_view text);

  /// As it was written.
  const std::string& text() const noexcept { return text_; }

  /// Whether it has a pre-release part ("1.0.0-rc.1"): never chosen unless it is asked for.
  bool is_prerelease() const noexcept { return !prerelease_.empty(); }

  std::weak_ordering operator<=>(const Version& other) const;
  bool operator==(const Version& other) const { return (*this <=> other) == 0; }

 private:
  std::string text_;
  std::vector<std::string> numbers_;     // major, minor, patch: digits without leading zeros
  std::vector<std::string> prerelease_;  // the identifiers between '-' and '+'
};

}  // namespace fiona::marketplace
