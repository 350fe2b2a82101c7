#include "fiona/trust/access.hpp"

namespace fiona::trust {
namespace {

struct Named {
  Access access;
  std::string_view name;
};
constexpr Named kNamed[] = {{Access::Nothing, "nothing"},       {Access::Observe, "observe"},
                            {Access::Operate, "operate"},       {Access::Compose, "compose"},
                            {Access::Administer, "administer"}, {Access::Nobody, "nobody"}};

}  // namespace

std::string access_name(Access access) {
  for (const Named& one : kNamed) {
    if (one.access == access) return std::string(one.name);
  }
  return std::to_string(static_cast<int>(access));
}

std::string access_text(Access access) {
  return access_name(access) + " (" + std::to_string(static_cast<int>(access)) + ")";
}

std::optional<Access> access_of(std::string_view name) {
  for (const Named& one : kNamed) {
    if (one.name == name && one.access != Access::Nothing && one.access != Access::Nobody) return one.access;
  }
  return std::nullopt;
}

}  // namespace fiona::trust
