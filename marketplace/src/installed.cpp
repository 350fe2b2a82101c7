#include "installed.hpp"

#include <fcntl.h>

#include <fiona/error.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <set>

#include "files.hpp"
#include "text_check.hpp"

namespace fiona::marketplace {
namespace {

constexpr std::uint64_t kMostInstalledBytes = std::uint64_t{64} << 20;

void check_entry(const fiona::InstalledPackage& package, const std::string& where, std::set<std::string>& names) {
  check_packed_manifest(package.manifest(), where);
  const std::string prefix = std::string(kPackagesDirectory) + "/";
  const std::string& directory = package.directory();
  if (!directory.starts_with(prefix) || !is_blake2b(std::string_view(directory).substr(prefix.size()))) {
    throw Error(ErrorCode::Failed, ErrorText{.what = full_name(package.manifest()) + " has no directory of this store",
                                             .where = where,
                                             .expected = "packages/HASH",
                                             .found = directory});
  }
  if (!names.insert(full_name(package.manifest())).second) {
    throw Error(ErrorCode::Failed, full_name(package.manifest()) + " is listed twice");
  }
}

}  // namespace

Installed read_installed(const std::filesystem::path& store) {
  const std::filesystem::path path = store / kInstalledFile;
  Installed installed;
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file) return installed;
  try {
    parse_text(read_all(file, kMostInstalledBytes, path), path.string(), installed);
    std::set<std::string> names;
    for (const auto& package : installed.packages()) check_entry(package, path.string(), names);
  } catch (const Error& error) {
    ErrorText text = error.text();
    text.what = "the list of installed packages is damaged: " + text.what;
    text.next = "move " + path.string() + " away and install the packages again";
    throw Error(error.code(), text);
  }
  return installed;
}

}  // namespace fiona::marketplace
