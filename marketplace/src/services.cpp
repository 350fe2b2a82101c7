#include "services.hpp"

#include <fiona/marketplace/manifest.hpp>
#include <map>
#include <set>

namespace fiona::marketplace {
namespace {

std::set<std::string> services_of(const Interface& interface, Direction direction) {
  std::set<std::string> services;
  for (const auto& component : interface.components()) {
    for (const auto& port : component.ports()) {
      if (port.direction() == direction) services.insert(port.service());
    }
  }
  return services;
}

// Of each service the packages that provide it.
std::map<std::string, std::vector<std::string>> providers_in(const Marketplace& from) {
  std::map<std::string, std::vector<std::string>> providers;
  for (const auto& entry : from.search({})) {
    for (const auto& service : services_of(entry.interface(), PROVIDES))
      providers[service].push_back(full_name(entry.manifest()));
  }
  return providers;
}

std::vector<MissingService> unserved_ports(const ServingPackage& package, const std::set<std::string>& provided) {
  std::vector<MissingService> missing;
  for (const auto& component : package.interface.components()) {
    for (const auto& port : component.ports()) {
      if (port.direction() != REQUIRES || port.optional() || provided.contains(port.service())) continue;
      missing.push_back({package.name + ": " + component.name() + "." + port.name(), port.service(), {}});
    }
  }
  return missing;
}

}  // namespace

std::vector<MissingService> missing_services(const std::vector<ServingPackage>& packages,
                                             const std::vector<ServingPackage>& all, const Marketplace& from) {
  std::set<std::string> provided;
  for (const auto& package : all) provided.merge(services_of(package.interface, PROVIDES));
  std::vector<MissingService> missing;
  for (const auto& package : packages) {
    for (auto& one : unserved_ports(package, provided)) missing.push_back(std::move(one));
  }
  if (missing.empty()) return missing;
  const auto providers = providers_in(from);
  for (auto& one : missing) {
    if (const auto found = providers.find(one.service); found != providers.end()) one.providers = found->second;
  }
  return missing;
}

}  // namespace fiona::marketplace
