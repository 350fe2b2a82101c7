#include "installed.hpp"

#include <fcntl.h>

#include <algorithm>
#include <charconv>
#include <fiona/error.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <optional>
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
    throw Error(ErrorCode::Failed, {.what = full_name(package.manifest()) + " is listed twice",
                                    .next = "go back to the state before: market rollback"});
  }
}

// Nothing if there is no such file.
std::optional<Installed> read_list(const std::filesystem::path& path, const std::string& next) {
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file) return std::nullopt;
  Installed installed;
  try {
    parse_text(read_all(file, kMostInstalledBytes, path), path.string(), installed);
    std::set<std::string> names;
    for (const auto& package : installed.packages()) check_entry(package, path.string(), names);
  } catch (const Error& error) {
    ErrorText text = error.text();
    text.what = "the list of installed packages is damaged: " + text.what;
    text.next = next;
    throw Error(error.code(), text);
  }
  return installed;
}

// The number of "7.textproto".
std::optional<std::uint64_t> generation_of(const std::string& name) {
  std::uint64_t number = 0;
  const auto [end, failure] = std::from_chars(name.data(), name.data() + name.size(), number);
  if (failure != std::errc{} || name != generation_file(number)) return std::nullopt;
  return number;
}

}  // namespace

Installed read_installed(const std::filesystem::path& store) {
  const std::filesystem::path path = store / kInstalledFile;
  const std::string next = "move " + path.string() + " away and install the packages again; earlier lists are in " +
                           (store / kGenerationsDirectory).string();
  return read_list(path, next).value_or(Installed{});
}

Revocations read_revocations(const std::filesystem::path& store) {
  const std::filesystem::path path = store / kRevokedFile;
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  Revocations revoked;
  if (!file) return revoked;
  try {
    parse_text(read_all(file, kMostInstalledBytes, path), path.string(), revoked);
  } catch (const Error& error) {
    // Without it, what was revoked would be started.
    ErrorText text = error.text();
    text.what = "the list of revoked packages is damaged: " + text.what;
    text.next = "remove " + path.string() + ", then: market update, which asks the marketplaces again";
    throw Error(error.code(), text);
  }
  return revoked;
}

std::vector<std::uint64_t> kept_generations(const std::filesystem::path& store) {
  std::vector<std::uint64_t> numbers;
  std::error_code failure;
  std::filesystem::directory_iterator entry{store / kGenerationsDirectory, failure};
  for (; !failure && entry != std::filesystem::directory_iterator{}; entry.increment(failure)) {
    if (const auto number = generation_of(entry->path().filename().string())) numbers.push_back(*number);
  }
  std::ranges::sort(numbers);
  return numbers;
}

Installed read_generation(const std::filesystem::path& store, std::uint64_t number) {
  const std::filesystem::path path = store / kGenerationsDirectory / generation_file(number);
  if (auto list = read_list(path, "choose another generation: market history")) return *std::move(list);
  std::string kept;
  for (const auto one : kept_generations(store)) kept += (kept.empty() ? "" : ", ") + std::to_string(one);
  throw Error(ErrorCode::NotFound,
              ErrorText{.what = "generation " + std::to_string(number) + " of the store is not kept",
                        .where = store.string(),
                        .expected = kept.empty() ? "there is none to go back to" : "one of " + kept,
                        .next = "market history"});
}

std::string from_option(const std::string& source) {
  return source.empty() || source == Marketplace::default_directory() ? "" : " --from " + source;
}

std::string generation_file(std::uint64_t number) { return std::to_string(number) + ".textproto"; }

std::string hash_of(const fiona::InstalledPackage& package) {
  return std::filesystem::path(package.directory()).filename().string();
}

}  // namespace fiona::marketplace
