#pragma once

#include <fiona/marketplace/plan.hpp>
#include <vector>

namespace fiona::marketplace {

/// A package as far as its services count.
struct ServingPackage {
  std::string name;  ///< "publisher/name"
  Interface interface;
};

/// The required ports of `packages`, optional ones excepted, whose service none of `all` provides, with packages of the
/// marketplace that would.
std::vector<MissingService> missing_services(const std::vector<ServingPackage>& packages,
                                             const std::vector<ServingPackage>& all, const Marketplace& from);

}  // namespace fiona::marketplace
