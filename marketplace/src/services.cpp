#include "services.hpp"

#include <fiona/marketplace/manifest.hpp>
#include <set>

namespace fiona::marketplace {
namespace {

std::set<std::string> provided_by(const std::vector<ServingPackage>& packages) {
  std::set<std::string> services;
  for (const auto& package : packages) {
    for (const auto& component : package.interface.components()) {
      for (const auto& port : component.ports()) {
        if (port.direction() == PROVIDES) services.insert(port.service());
      }
    }
  }
  return services;
}

}  // namespace

std::vector<MissingService> missing_services(const std::vector<ServingPackage>& packages,
                                             const std::vector<ServingPackage>& all, const Marketplace& from) {
  const std::set<std::string> provided = provided_by(all);
  std::vector<MissingService> missing;
  for (const auto& package : packages) {
    for (const auto& component : package.interface.components()) {
      for (const auto& port : component.ports()) {
        if (port.direction() != REQUIRES || port.optional() || provided.contains(port.service())) continue;
        MissingService& one = missing.emplace_back();
        one.port = package.name + ": " + component.name() + "." + port.name();
        one.service = port.service();
        for (const auto& entry : from.providers_of(port.service()))
          one.providers.push_back(full_name(entry.manifest()));
      }
    }
  }
  return missing;
}

}  // namespace fiona::marketplace
