#include <fiona/error.hpp>

#include <algorithm>
#include <numeric>
#include <utility>

namespace fiona {
namespace {

std::string render(const ErrorText& text) {
  std::string out = text.where.empty() ? text.what : text.where + ": " + text.what;
  const auto line = [&out](std::string_view label, const std::string& value) {
    if (!value.empty()) out.append("\n  ").append(label).append(value);
  };
  line("expected: ", text.expected);
  line("found: ", text.found);
  std::string near;
  for (const auto& name : text.near) near += (near.empty() ? "" : ", ") + name;
  line("did you mean: ", near);
  line("next: ", text.next);
  return out;
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> before(b.size() + 1), previous(b.size() + 1), current(b.size() + 1);
  std::iota(previous.begin(), previous.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    current[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t cost = a[i - 1] == b[j - 1] ? 0 : 1;
      current[j] = std::min({previous[j] + 1, current[j - 1] + 1, previous[j - 1] + cost});
      const bool swapped = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
      if (swapped) current[j] = std::min(current[j], before[j - 2] + 1);
    }
    std::swap(before, previous);
    std::swap(previous, current);
  }
  return previous[b.size()];
}

}  // namespace

Error::Error(ErrorCode code, ErrorText text) : code_(code), text_(std::move(text)), rendered_(render(text_)) {}

std::vector<std::string> nearest_names(std::string_view typed, std::span<const std::string> known) {
  std::vector<std::pair<std::size_t, std::string>> ranked;
  const std::size_t most = std::max<std::size_t>(1, typed.size() / 3);
  for (const auto& name : known) {
    const bool prefix = typed.size() >= 2 && name.starts_with(typed);
    // At least so far apart: what came over a network may be megabytes, and is not to cost the product of both lengths.
    const std::size_t apart = std::max(typed.size(), name.size()) - std::min(typed.size(), name.size());
    if (!prefix && apart > most) continue;
    const std::size_t distance = prefix ? 0 : edit_distance(typed, name);
    if (distance <= most) ranked.emplace_back(distance, name);
  }
  std::sort(ranked.begin(), ranked.end());
  std::vector<std::string> names;
  for (auto& [distance, name] : ranked) {
    if (names.size() < 3) names.push_back(std::move(name));
  }
  return names;
}

}  // namespace fiona
