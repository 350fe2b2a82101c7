#include <algorithm>
#include <fiona/marketplace/version.hpp>

namespace fiona::marketplace {
namespace {

constexpr std::string_view kDigits = "0123456789";
constexpr std::string_view kIdentifier = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ-";

bool only(std::string_view text, std::string_view allowed) {
  return !text.empty() && text.find_first_not_of(allowed) == std::string_view::npos;
}

bool is_number(std::string_view text) { return only(text, kDigits); }

bool has_leading_zero(std::string_view text) { return text.size() > 1 && text.front() == '0'; }

std::vector<std::string> split_at_dots(std::string_view text) {
  std::vector<std::string> parts;
  for (std::size_t begin = 0;;) {
    const std::size_t dot = text.find('.', begin);
    parts.emplace_back(text.substr(begin, dot - begin));
    if (dot == std::string_view::npos) return parts;
    begin = dot + 1;
  }
}

std::strong_ordering compare_numbers(std::string_view a, std::string_view b) {
  return a.size() != b.size() ? a.size() <=> b.size() : a <=> b;
}

// semver.org, rule 11.4: numbers by value and below words, words by bytes.
std::strong_ordering compare_identifiers(std::string_view a, std::string_view b) {
  if (is_number(a) && is_number(b)) return compare_numbers(a, b);
  if (is_number(a) != is_number(b)) return is_number(a) ? std::strong_ordering::less : std::strong_ordering::greater;
  return a <=> b;
}

}  // namespace

std::optional<Version> Version::parse(std::string_view text) {
  if (text.size() > 64) return std::nullopt;
  Version version;
  version.text_ = text;
  const auto all = [](const std::vector<std::string>& parts, auto&& fits) { return std::ranges::all_of(parts, fits); };
  if (const std::size_t plus = text.find('+'); plus != std::string_view::npos) {
    const auto build = split_at_dots(text.substr(plus + 1));
    if (!all(build, [](const std::string& part) { return only(part, kIdentifier); })) return std::nullopt;
    text = text.substr(0, plus);
  }
  if (const std::size_t dash = text.find('-'); dash != std::string_view::npos) {
    version.prerelease_ = split_at_dots(text.substr(dash + 1));
    const auto fits = [](const std::string& part) {
      return only(part, kIdentifier) && !(is_number(part) && has_leading_zero(part));
    };
    if (!all(version.prerelease_, fits)) return std::nullopt;
    text = text.substr(0, dash);
  }
  version.numbers_ = split_at_dots(text);
  const auto fits = [](const std::string& part) { return is_number(part) && !has_leading_zero(part); };
  if (version.numbers_.size() != 3 || !all(version.numbers_, fits)) return std::nullopt;
  return version;
}

std::weak_ordering Version::operator<=>(const Version& other) const {
  for (std::size_t i = 0; i < 3; ++i) {
    if (const auto order = compare_numbers(numbers_[i], other.numbers_[i]); order != 0) return order;
  }
  if (is_prerelease() != other.is_prerelease()) {
    return is_prerelease() ? std::weak_ordering::less : std::weak_ordering::greater;
  }
  return std::lexicographical_compare_three_way(prerelease_.begin(), prerelease_.end(), other.prerelease_.begin(),
                                                other.prerelease_.end(), compare_identifiers);
}

}  // namespace fiona::marketplace
