#include "names.hpp"

#include <vector>

#include "text_check.hpp"

namespace fiona::marketplace {
namespace {

std::string short_name(const std::string& full) { return full.substr(full.find('/') + 1); }

std::vector<std::string> nearest(std::string_view typed, const std::set<std::string>& known) {
  const std::vector<std::string> full{known.begin(), known.end()};
  if (typed.find('/') != std::string_view::npos) return nearest_names(typed, full);
  std::set<std::string> names;
  for (const auto& name : full) names.insert(short_name(name));
  const std::vector<std::string> unique{names.begin(), names.end()};
  return nearest_names(typed, unique);
}

}  // namespace

std::string resolve_name(std::string_view typed, const std::set<std::string>& known, const std::string& unknown,
                         const std::string& where, const std::string& next) {
  const std::string name = text_fault(typed, false).empty() ? std::string(typed) : "that";
  std::vector<std::string> found;
  for (const auto& full : known) {
    if (full == typed || short_name(full) == typed) found.push_back(full);
  }
  if (found.size() == 1) return found.front();
  if (found.empty()) {
    throw Error(ErrorCode::NotFound,
                ErrorText{.what = unknown + " " + name, .where = where, .next = next, .near = nearest(typed, known)});
  }
  std::string all;
  for (const auto& full : found) all += (all.empty() ? "" : ", ") + full;
  throw Error(ErrorCode::NotFound, ErrorText{.what = "several publishers have a package " + name,
                                             .where = where,
                                             .expected = "one of " + all,
                                             .next = "name the publisher too: " + found.front(),
                                             .near = found});
}

}  // namespace fiona::marketplace
