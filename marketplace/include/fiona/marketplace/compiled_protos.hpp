#pragma once

#include <fiona/marketplace/store.hpp>
#include <string>
#include <vector>

#include "fiona/manifest.pb.h"

namespace fiona::marketplace {

/// Derives from an interface which proto files a package offers to others (kind MESSAGES only) and which it shares,
/// each with the hash of its descriptor, and writes them into the manifest. C++ that was generated from a proto file
/// has the layout of its objects compiled in: two libraries work together only where these hashes are equal.
void list_protos(const Interface& interface, Manifest& manifest);

/// The message packages among these whose proto files a package shares, with those that they share in turn, each
/// before who needs it. Throws fiona::Error with `name` where nobody offers one in the form that it was compiled with
/// (NotFound), and where packages say that each needs the other (Failed).
std::vector<InstalledPackage> messages_of(const Manifest& manifest, const std::string& name,
                                          const std::vector<InstalledPackage>& packages);

}  // namespace fiona::marketplace
