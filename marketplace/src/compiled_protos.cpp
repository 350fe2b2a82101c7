#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/compiled_protos.hpp>
#include <fiona/marketplace/hash.hpp>

namespace fiona::marketplace {
namespace {

bool offers(const Manifest& manifest, const CompiledProto& proto) {
  return std::ranges::any_of(manifest.offered(), [&proto](const CompiledProto& offered) {
    return offered.name() == proto.name() && offered.blake2b() == proto.blake2b();
  });
}

void add_messages(const Manifest& manifest, const std::string& name, const std::vector<InstalledPackage>& packages,
                  std::vector<InstalledPackage>& found) {
  for (const auto& proto : manifest.shared()) {
    const auto offering = [&proto](const InstalledPackage& package) { return offers(package.manifest, proto); };
    if (std::ranges::any_of(found, offering)) continue;
    const auto package = std::ranges::find_if(packages, offering);
    if (package == packages.end()) {
      throw Error(
          ErrorCode::NotFound,
          {.what = "'" + name + "' was compiled with a form of " + proto.name() + " that nothing installed offers",
           .next = "plugin messages lists what is offered: build it with that, or install what it was built with"});
    }
    add_messages(package->manifest, package->name(), packages, found);
    found.push_back(*package);
  }
}

}  // namespace

void list_protos(const Interface& interface, Manifest& manifest) {
  manifest.clear_offered();
  manifest.clear_shared();
  for (const auto& file : interface.descriptors().file()) {
    const bool is_shared = std::ranges::find(interface.shared(), file.name()) != interface.shared().end();
    if (!is_shared && manifest.kind() != MESSAGES) continue;
    CompiledProto& proto = is_shared ? *manifest.add_shared() : *manifest.add_offered();
    proto.set_name(file.name());
    proto.set_blake2b(blake2b(file.SerializeAsString()));
  }
}

std::vector<InstalledPackage> messages_of(const Manifest& manifest, const std::string& name,
                                          const std::vector<InstalledPackage>& packages) {
  std::vector<InstalledPackage> found;
  add_messages(manifest, name, packages, found);
  return found;
}

}  // namespace fiona::marketplace
