#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/package.hpp>
#include <fiona/marketplace/version.hpp>

#include "index_file.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

IndexEntry* find_version(Index& index, const Manifest& manifest) {
  for (auto& entry : *index.mutable_entries()) {
    const bool same = full_name(entry.manifest()) == full_name(manifest) &&
                      entry.manifest().architecture() == manifest.architecture() &&
                      *Version::parse(entry.manifest().version()) == *Version::parse(manifest.version());
    if (same) return &entry;
  }
  return nullptr;
}

[[noreturn]] void refuse_other_content(const char* published, const std::string& blake2b, const IndexEntry& entry,
                                       const filesystem::path& marketplace, const std::string& next) {
  throw Error(ErrorCode::NotAllowed, ErrorText{.what = full_name(entry.manifest()) + " " + entry.manifest().version() +
                                                       published + ", with other content",
                                               .where = marketplace.string(),
                                               .expected = blake2b,
                                               .found = entry.blake2b(),
                                               .next = next});
}

// What comes back is what was withdrawn, to the byte.
void take_back_withdrawal(Index& index, const IndexEntry& entry, const filesystem::path& marketplace,
                          const std::string& next) {
  const Manifest& manifest = entry.manifest();
  auto& all = *index.mutable_withdrawn();
  const auto found = std::ranges::find_if(all, [&](const Withdrawal& one) {
    const auto version = Version::parse(one.version());
    return one.package() == full_name(manifest) && one.architecture() == manifest.architecture() && version &&
           *version == *Version::parse(manifest.version());
  });
  if (found == all.end()) return;
  if (found->blake2b() != entry.blake2b())
    refuse_other_content(" was published and withdrawn", found->blake2b(), entry, marketplace, next);
  all.erase(found);
}

}  // namespace

IndexEntry entry_for(const PackageContents& contents) {
  IndexEntry entry;
  *entry.mutable_manifest() = contents.manifest;
  *entry.mutable_interface() = contents.interface;
  entry.mutable_interface()->clear_descriptors();
  entry.set_file(package_file_name(contents.manifest, contents.blake2b));
  entry.set_size(contents.size);
  entry.set_blake2b(contents.blake2b);
  return entry;
}

bool add_entry(Index& index, const IndexEntry& entry, bool replace, const filesystem::path& marketplace,
               const std::string& next) {
  IndexEntry* published = find_version(index, entry.manifest());
  if (published && published->blake2b() == entry.blake2b()) return false;
  if (published && !replace)
    refuse_other_content(" is published already", published->blake2b(), entry, marketplace, next);
  if (!replace) take_back_withdrawal(index, entry, marketplace, next);
  *(published ? published : index.add_entries()) = entry;
  index.set_generation(index.generation() + 1);
  std::ranges::sort(*index.mutable_entries(), {}, &IndexEntry::file);
  return true;
}

}  // namespace fiona::marketplace
