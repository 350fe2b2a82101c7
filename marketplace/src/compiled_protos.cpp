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

/// The message packages that one package needs, and so on.
class Needed {
 public:
  explicit Needed(const std::vector<InstalledPackage>& packages) : packages_(packages) {}

  void add_of(const Manifest& manifest, const std::string& name) {
    within_.push_back(name);
    for (const auto& proto : manifest.shared()) {
      const auto offering = [&proto](const InstalledPackage& package) { return offers(package.manifest, proto); };
      if (std::ranges::any_of(found, offering)) continue;
      const auto package = std::ranges::find_if(packages_, offering);
      if (package == packages_.end()) refuse_missing(name, proto);
      if (std::ranges::find(within_, package->name()) != within_.end()) refuse_circle(name, package->name());
      add_of(package->manifest, package->name());
      found.push_back(*package);
    }
    within_.pop_back();
  }

  std::vector<InstalledPackage> found;

 private:
  [[noreturn]] static void refuse_missing(const std::string& name, const CompiledProto& proto) {
    throw Error(
        ErrorCode::NotFound,
        {.what = "'" + name + "' was compiled with a form of " + proto.name() + " that nothing installed offers",
         .next = "plugin messages lists what is offered: build it with that, or install what it was built with"});
  }
  // Nobody can build that, but anybody can write it into a manifest.
  [[noreturn]] static void refuse_circle(const std::string& name, const std::string& other) {
    throw Error(ErrorCode::Failed, {.what = "'" + name + "' says that it was compiled with objects of '" + other +
                                            "', which cannot be opened before '" + name + "'",
                                    .next = "market remove " + name + ", and tell its publisher"});
  }

  const std::vector<InstalledPackage>& packages_;
  std::vector<std::string> within_;  ///< whose needs are being looked up
};

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
  Needed needed(packages);
  needed.add_of(manifest, name);
  return std::move(needed.found);
}

}  // namespace fiona::marketplace
