#include "keeper_packages.hpp"

#include <fcntl.h>

#include <algorithm>
#include <array>
#include <fiona/error.hpp>
#include <fiona/marketplace/package.hpp>

#include "files.hpp"
#include "index_file.hpp"
#include "tuf/digest.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

std::string sha256_of_file(const filesystem::path& path) {
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file)
    throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no such file",
                                               .where = path.string(),
                                               .next = "see what is there: ls " + path.parent_path().string()});
  tuf::Digests digests{{{"sha256", ""}}};
  std::array<char, 1 << 16> buffer;
  while (const std::size_t count = read_some(file.number(), buffer.data(), buffer.size(), path)) {
    digests.update({buffer.data(), count});
  }
  return digests.finish().at("sha256");
}

}  // namespace

ReadPackage read_for_keeping(const filesystem::path& path, const KeeperOptions& options) {
  const PackageContents contents = inspect_package(path, options.limits);
  return {entry_for(contents), target_path(contents.manifest), sha256_of_file(path)};
}

void copy_checked(const filesystem::path& from, const std::string& sha256, const DurableDirectory& to,
                  const std::string& name) {
  const std::string fresh = name + ".new";
  to.remove_file(fresh);
  try {
    const FileDescriptor source = open_regular(AT_FDCWD, from, from);
    if (!source)
      throw Error(ErrorCode::NotFound, ErrorText{.what = "the package has gone",
                                                 .where = from.string(),
                                                 .next = "pack it again, and publish it: plugin pack"});
    tuf::Digests digests{{{"sha256", ""}}};
    const FileDescriptor target = to.create(fresh, 0644);
    std::array<char, 1 << 16> buffer;
    while (const std::size_t count = read_some(source.number(), buffer.data(), buffer.size(), from)) {
      digests.update({buffer.data(), count});
      to.write(target, {buffer.data(), count}, fresh);
    }
    to.sync(target, fresh);
    if (digests.finish().at("sha256") != sha256) {
      throw Error(ErrorCode::Failed, ErrorText{.what = "the package changed while it was being copied",
                                               .where = from.string(),
                                               .next = "do this again"});
    }
    to.move(fresh, to, name);
  } catch (...) {
    to.remove_tree_quietly(fresh);
    throw;
  }
}

const tuf::TargetInfo* find_target(const std::vector<tuf::TargetInfo>& targets, const std::string& path) {
  const auto found = std::ranges::find(targets, path, &tuf::TargetInfo::path);
  return found == targets.end() ? nullptr : &*found;
}

bool signs_for(const tuf::RoleContent& role, const ReadPackage& package) {
  const tuf::TargetInfo* target = find_target(role.targets, package.path);
  return target && target->length == package.entry.size() && target->hashes.contains("sha256") &&
         target->hashes.at("sha256") == package.sha256;
}

std::string package_named(const std::string& path) {
  const std::size_t dot = path.find('.'), version = path.rfind('-', dot) + 1,
                    end = path.rfind('-');  // no name has a '.'
  return path.substr(0, version - 1) + "@" + path.substr(version, end - version);
}

std::string consistent_name(const std::string& path, const std::string& sha256) {
  return sha256 + "." + path.substr(path.find('/') + 1);
}

}  // namespace fiona::marketplace
