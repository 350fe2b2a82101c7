#include <algorithm>
#include <array>
#include <fiona/error.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/requirement.hpp>

#include "text_check.hpp"

namespace fiona::marketplace {
namespace {

using Comparison = VersionRange::Comparison;

struct Spelling {
  std::string_view text;
  Comparison comparison;
};
// Those that begin alike: the longer first.
constexpr std::array kSpellings{Spelling{">=", Comparison::GreaterEqual}, Spelling{"<=", Comparison::LessEqual},
                                Spelling{">", Comparison::Greater}, Spelling{"<", Comparison::Less},
                                Spelling{"=", Comparison::Equal}};
constexpr std::size_t kMostBounds = 8;

std::string_view trimmed(std::string_view text) {
  const std::size_t begin = text.find_first_not_of(' ');
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(' ') - begin + 1);
}

[[noreturn]] void refuse(const std::string& where, std::string_view text, const char* what, const char* expected) {
  throw Error(ErrorCode::Failed, ErrorText{.what = what,
                                           .where = where,
                                           .expected = expected,
                                           .found = text_fault(text, false).empty() ? "\"" + std::string(text) + "\""
                                                                                    : "what is not text"});
}

VersionRange::Bound parse_bound(std::string_view text, const std::string& where) {
  for (const Spelling& spelling : kSpellings) {
    if (!text.starts_with(spelling.text)) continue;
    const auto version = Version::parse(trimmed(text.substr(spelling.text.size())));
    if (!version) break;
    return {spelling.comparison, *version};
  }
  refuse(where, text, "these are not bounds of versions", "such as >= 1.2.0, < 2.0.0");
}

bool holds(const VersionRange::Bound& bound, const Version& version) {
  switch (bound.comparison) {
    case Comparison::Less: return version < bound.version;
    case Comparison::LessEqual: return version <= bound.version;
    case Comparison::Equal: return version == bound.version;
    case Comparison::GreaterEqual: return version >= bound.version;
    case Comparison::Greater: return version > bound.version;
  }
  return false;
}

}  // namespace

VersionRange VersionRange::parse(std::string_view text, const std::string& where) {
  VersionRange range;
  std::string_view rest = trimmed(text);
  while (!rest.empty()) {
    const std::size_t comma = rest.find(',');
    range.bounds_.push_back(parse_bound(trimmed(rest.substr(0, comma)), where));
    if (range.bounds_.size() > kMostBounds) refuse(where, text, "these are too many bounds", "at most 8");
    if (comma == std::string_view::npos) break;
    rest = trimmed(rest.substr(comma + 1));
    if (rest.empty()) refuse(where, text, "these are not bounds of versions", "such as >= 1.2.0, < 2.0.0");
  }
  return range;
}

bool VersionRange::has(const Version& version) const {
  return std::ranges::all_of(bounds_, [&](const Bound& bound) { return holds(bound, version); });
}

std::string VersionRange::text() const {
  std::string text;
  for (const Bound& bound : bounds_) {
    text += (text.empty() ? "" : ", ") + std::string(comparison_text(bound.comparison)) + " " + bound.version.text();
  }
  return text;
}

std::string_view comparison_text(Comparison comparison) {
  return std::ranges::find(kSpellings, comparison, &Spelling::comparison)->text;
}

Requirement Requirement::parse(std::string_view text, const std::string& where) {
  const std::string_view whole = trimmed(text);
  const std::size_t end = whole.find_first_of(" <>=,");
  const std::string_view name = whole.substr(0, end);
  const std::size_t slash = name.find('/');
  if (slash == std::string_view::npos || !is_name(name.substr(0, slash)) || !is_name(name.substr(slash + 1)))
    refuse(where, text, "this does not name a package", "publisher/name, then bounds of versions, if any");
  const std::string_view bounds = end == std::string_view::npos ? std::string_view{} : whole.substr(end);
  return {std::string(name), VersionRange::parse(bounds, where)};
}

std::string Requirement::text() const {
  const std::string bounds = versions.text();
  return bounds.empty() ? package : package + " " + bounds;
}

bool requires_package(const Manifest& manifest, const std::string& package) {
  return std::ranges::any_of(manifest.requirements(), [&](const auto& text) {
    return Requirement::parse(text, full_name(manifest)).package == package;
  });
}

}  // namespace fiona::marketplace
