#include <fcntl.h>

#include <algorithm>
#include <cstdlib>
#include <fiona/error.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <map>
#include <set>

#include "files.hpp"
#include "index_file.hpp"
#include "names.hpp"
#include "signed_market.hpp"
#include "text_check.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

Version version_of(const IndexEntry& entry) { return *Version::parse(entry.manifest().version()); }

bool fits_this_machine(const IndexEntry& entry) {
  return entry.manifest().architecture().empty() || entry.manifest().architecture() == this_architecture();
}

// The order in which versions are offered: those for this machine, then releases, then the newest.
bool is_offered_before(const IndexEntry& a, const IndexEntry& b) {
  if (fits_this_machine(a) != fits_this_machine(b)) return fits_this_machine(a);
  const Version version_a = version_of(a), version_b = version_of(b);
  if (version_a.is_prerelease() != version_b.is_prerelease()) return version_b.is_prerelease();
  return version_b < version_a;
}

std::string lower(std::string text) {
  std::ranges::transform(text, text.begin(), [](char c) { return c >= 'A' && c <= 'Z' ? char(c - 'A' + 'a') : c; });
  return text;
}

std::string searchable(const IndexEntry& entry) {
  std::string text = full_name(entry.manifest()) + "\n" + entry.manifest().summary();
  for (const auto& component : entry.interface().components()) {
    text += "\n" + component.name() + "\n" + component.doc();
    for (const auto& port : component.ports()) text += "\n" + port.service();
  }
  return lower(text);
}

bool provides(const IndexEntry& entry, std::string_view service) {
  return std::ranges::any_of(entry.interface().components(), [&](const ComponentInterface& component) {
    return std::ranges::any_of(component.ports(), [&](const PortInterface& port) {
      return port.direction() == PROVIDES && port.service() == service;
    });
  });
}

template <typename Wanted>
std::vector<IndexEntry> newest_where(const Index& index, Wanted&& wanted) {
  std::map<std::string, const IndexEntry*> newest;
  for (const auto& entry : index.entries()) {
    const IndexEntry*& best = newest[full_name(entry.manifest())];
    if (!best || is_offered_before(entry, *best)) best = &entry;
  }
  std::vector<IndexEntry> entries;
  for (const auto& [name, entry] : newest) {
    if (wanted(*entry)) entries.push_back(*entry);
  }
  return entries;
}

[[noreturn]] void refuse_version(std::string_view version, const std::vector<IndexEntry>& entries,
                                 const Marketplace& from) {
  std::string known;
  for (const auto& entry : entries) known += (known.empty() ? "" : ", ") + entry.manifest().version();
  const std::string name = full_name(entries.front().manifest());
  throw Error(ErrorCode::NotFound, ErrorText{.what = "the marketplace has no such version of " + name,
                                             .where = from.source(),
                                             .expected = "one of " + known,
                                             .found = text_fault(version, false).empty() ? std::string(version) : "",
                                             .next = "market install " + name + from.option()});
}

void check_entry(const IndexEntry& entry, const std::string& where) {
  check_packed_manifest(entry.manifest(), where);
  const std::string name = full_name(entry.manifest());
  std::string fault = texts_fault(entry.interface());
  if (entry.file() != package_file_name(entry.manifest(), entry.blake2b())) fault = "its file name is not its own";
  if (!is_blake2b(entry.blake2b())) fault = "it has no hash";
  if (!fault.empty()) {
    throw Error(ErrorCode::Failed,
                ErrorText{.what = "the entry of " + name + " is wrong: " + fault,
                          .where = where,
                          .next = "tell the marketplace's keeper; its other packages need a mended index, too"});
  }
}

void check_revocation(const Revocation& revoked, const std::string& where) {
  std::string fault = texts_fault(revoked);
  if (!is_blake2b(revoked.blake2b())) fault = "it has no hash";
  if (!fault.empty())
    throw Error(
        ErrorCode::Failed,
        ErrorText{.what = "a revocation is wrong: " + fault, .where = where, .next = "tell the marketplace's keeper"});
}

template <class Parts>
void check_all(Parts& parts, void (*check)(const typename Parts::value_type&, const std::string&),
               const std::string& where, std::size_t* left_out) {
  for (auto part = parts.begin(); part != parts.end();) {
    try {
      check(*part, where);
      ++part;
    } catch (const Error&) {
      if (left_out == nullptr) throw;
      ++*left_out;
      part = parts.erase(part);
    }
  }
}

}  // namespace

std::string package_file_name(const Manifest& manifest, std::string_view blake2b) {
  const std::string architecture = manifest.architecture().empty() ? "any" : manifest.architecture();
  return manifest.publisher() + "." + manifest.name() + "-" + manifest.version() + "-" + architecture + "-" +
         std::string(blake2b.substr(0, 16)) + ".fpk";
}

std::string target_path(const Manifest& manifest) {
  const std::string architecture = manifest.architecture().empty() ? "any" : manifest.architecture();
  return manifest.publisher() + "/" + manifest.name() + "-" + manifest.version() + "-" + architecture + ".fpk";
}

std::optional<Index> read_index(const filesystem::path& directory, std::size_t* left_out) {
  const filesystem::path path = directory / kIndexFile;
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file) return std::nullopt;
  return parse_index(read_all(file, kMostIndexFileBytes, path), path.string(), left_out);
}

Index parse_index(std::string_view bytes, const std::string& where, std::size_t* left_out) {
  Index index;
  try {
    if (!index.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) {
      throw Error(ErrorCode::Failed, ErrorText{.what = "it is not an index",
                                               .where = where,
                                               .next = "name the folder or address that market init has made"});
    }
    check_all(*index.mutable_entries(), check_entry, where, left_out);
    check_all(*index.mutable_revoked(), check_revocation, where, left_out);
  } catch (const Error& error) {
    ErrorText text = error.text();
    text.what = "the marketplace's index is damaged: " + text.what;
    text.next = "publish the packages into a new directory, or choose another marketplace with --from";
    throw Error(error.code(), text);
  }
  return index;
}

Marketplace::Marketplace(filesystem::path directory)
    : directory_(filesystem::absolute(directory).lexically_normal()), source_(directory_.string()) {
  auto index = read_index(directory_, &left_out_);
  if (!index) {
    throw Error(ErrorCode::NotFound, ErrorText{.what = "there is no marketplace here: it has no index.binpb",
                                               .where = directory_.string(),
                                               .next = "choose one with --from DIR, or set FIONA_MARKET"});
  }
  index_ = std::move(*index);
  behind_.first_party = true;
}

Marketplace::Marketplace(const filesystem::path& copy, std::string source, Behind behind) : Marketplace(copy) {
  source_ = std::move(source);
  behind_ = std::move(behind);
}

std::vector<std::string> Marketplace::keys_of(const std::string& publisher) const {
  const auto found = behind_.keys.find(publisher);
  return found == behind_.keys.end() ? std::vector<std::string>{} : found->second;
}

filesystem::path Marketplace::package(const IndexEntry& entry) const {
  if (behind_.fetch) return behind_.fetch(entry);
  const filesystem::path path = directory_ / entry.file();
  std::error_code failure;
  if (filesystem::exists(path, failure)) return path;
  throw Error(ErrorCode::NotFound, ErrorText{.what = "the marketplace's index names a package that is not there",
                                             .where = path.string(),
                                             .next = "publish it again, or choose another marketplace with --from"});
}

std::array<filesystem::path, 2> Marketplace::shipped_directories() {
  std::error_code failure;
  const filesystem::path prefix = filesystem::read_symlink("/proc/self/exe", failure).parent_path().parent_path();
  return {prefix / "marketplace", prefix / "share/fiona/marketplace"};
}

filesystem::path Marketplace::default_directory() {
  if (const char* chosen = std::getenv("FIONA_MARKET"); chosen && *chosen) return chosen;
  std::error_code failure;
  const auto [built, installed] = shipped_directories();
  return filesystem::exists(built / "metadata/timestamp.json", failure) ? built : installed;
}

std::vector<IndexEntry> Marketplace::search(const std::vector<std::string>& words) const {
  return newest_where(index_, [&](const IndexEntry& entry) {
    const std::string text = searchable(entry);
    return std::ranges::all_of(words, [&](const auto& word) { return text.find(lower(word)) != std::string::npos; });
  });
}

std::vector<IndexEntry> Marketplace::info(std::string_view name) const {
  std::set<std::string> known;
  for (const auto& entry : index_.entries()) known.insert(full_name(entry.manifest()));
  const std::string full =
      resolve_name(name, known, "the marketplace has no package", source_, "market search" + option());
  std::vector<IndexEntry> entries;
  for (const auto& entry : index_.entries()) {
    if (full_name(entry.manifest()) == full) entries.push_back(entry);
  }
  std::ranges::sort(entries, [](const auto& a, const auto& b) { return version_of(b) < version_of(a); });
  return entries;
}

PackageRequest Marketplace::resolve(std::string_view request) const {
  const std::size_t at = request.find('@');
  const auto entries = info(request.substr(0, at));
  PackageRequest found{full_name(entries.front().manifest())};
  if (at == std::string_view::npos) return found;
  found.version = Version::parse(request.substr(at + 1));
  const auto asked_for = [&](const IndexEntry& entry) { return found.version && version_of(entry) == *found.version; };
  if (std::ranges::none_of(entries, asked_for)) refuse_version(request.substr(at + 1), entries, *this);
  return found;
}

std::vector<IndexEntry> Marketplace::providers_of(std::string_view service) const {
  return newest_where(index_, [&](const IndexEntry& entry) { return provides(entry, service); });
}

}  // namespace fiona::marketplace
