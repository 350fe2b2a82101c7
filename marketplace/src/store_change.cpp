#include "store_change.hpp"

#include <fcntl.h>
#include <google/protobuf/text_format.h>
#include <google/protobuf/util/message_differencer.h>
#include <sys/file.h>

#include <algorithm>
#include <ctime>
#include <fiona/error.hpp>

#include "files.hpp"
#include "installed.hpp"
#include "staging.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

constexpr std::string_view kStaging = "staging-";

std::string text_of(const Installed& list) {
  std::string text;
  google::protobuf::TextFormat::PrintToString(list, &text);
  return text;
}

void check_is(const IndexEntry& entry, const PackageContents& contents, const filesystem::path& path) {
  const bool same = contents.blake2b == entry.blake2b() && contents.size == entry.size() &&
                    google::protobuf::util::MessageDifferencer::Equals(contents.manifest, entry.manifest());
  if (same) return;
  throw Error(ErrorCode::BadSignature,
              ErrorText{.what = "the package is not the one that the index describes",
                        .where = path.string(),
                        .expected = entry.blake2b(),
                        .found = contents.blake2b,
                        .next = "publish it again, or choose another marketplace with --from"});
}

}  // namespace

StoreChange::StoreChange(const filesystem::path& store, const InstallOptions& options)
    : options_(options), store_(options_.os, store, 0700) {
  store_.lock(options_.lock_wait, options_.on_wait);
  packages_.emplace(store_.child(std::string(kPackagesDirectory), 0700));
  generations_.emplace(store_.child(std::string(kGenerationsDirectory), 0700));
  list_ = read_installed(store_.path());
  sweep();
}

fiona::InstalledPackage* StoreChange::find(const std::string& name) {
  for (auto& package : *list_.mutable_packages()) {
    if (full_name(package.manifest()) == name) return &package;
  }
  return nullptr;
}

bool StoreChange::is_whole(const Manifest& manifest, const std::string& blake2b) const {
  InstalledPackage package;
  package.manifest = manifest;
  package.directory = packages_->path() / blake2b;
  try {
    Store{store_.path()}.verify(package);
    return true;
  } catch (const Error& error) {
    if (error.code() != ErrorCode::BadSignature) throw;
    return false;
  }
}

void StoreChange::add_files(const IndexEntry& entry, const std::function<filesystem::path()>& fetch) {
  const std::string& hash = entry.blake2b();
  // A package that was taken out while somebody holds it is still there, and stays where its holder sees it.
  if (packages_->has(hash) && is_whole(entry.manifest(), hash)) return;
  const std::string staging = std::string(kStaging) + hash.substr(0, 16);
  try {
    unpack(entry, fetch(), staging);
    if (packages_->has(hash)) packages_->move(hash, store_, std::string(kStaging) + "damaged-" + hash.substr(0, 16));
    store_.move(staging, *packages_, hash);
  } catch (...) {
    store_.remove_tree_quietly(staging);
    drop_unlisted(hash);
    throw;
  }
}

// The list that is in force, under its number: a copy more if the power goes before the next is in force.
void StoreChange::keep_present() const {
  const Installed present = read_installed(store_.path());
  if (present.generation() == 0) return;  // there was none
  const std::string name = generation_file(present.generation());
  if (!generations_->has(name)) generations_->replace(name, text_of(present));
}

void StoreChange::write(const Installed& list) const {
  keep_present();
  store_.replace(std::string(kInstalledFile), text_of(list));
  forget_oldest();
}

void StoreChange::commit(const std::string& change) {
  const auto kept = kept_generations(store_.path());
  list_.set_previous(list_.generation());
  list_.set_generation(std::max(list_.generation(), kept.empty() ? 0 : kept.back()) + 1);
  list_.set_change(change);
  list_.set_time_s(std::time(nullptr));
  std::ranges::sort(*list_.mutable_packages(), {}, [](const auto& package) { return full_name(package.manifest()); });
  write(list_);
}

void StoreChange::commit_rollback(const Installed& then) {
  list_ = then;
  write(then);
}

// After the change: what cannot be forgotten now is forgotten after the next one.
void StoreChange::forget_oldest() const {
  auto kept = kept_generations(store_.path());
  std::erase_if(kept, [this](const auto number) { return number == list_.generation() || number == list_.previous(); });
  for (std::size_t i = 0; i + kKeptGenerations - 1 < kept.size(); ++i)
    generations_->remove_tree_quietly(generation_file(kept[i]));
}

void StoreChange::drop_unlisted(const std::string& blake2b) noexcept {
  try {
    if (!listed().contains(blake2b)) packages_->remove_tree_quietly(blake2b);
  } catch (const std::exception&) {
    // A list cannot be read: rather keep files than lose some that are in use.
  }
}

// The directories that the present list or a kept one names.
std::set<std::string> StoreChange::listed() const {
  std::set<std::string> hashes;
  const auto add = [&hashes](const Installed& list) {
    for (const auto& package : list.packages()) hashes.insert(hash_of(package));
  };
  add(read_installed(store_.path()));
  for (const auto number : kept_generations(store_.path())) add(read_generation(store_.path(), number));
  return hashes;
}

void StoreChange::sweep() const {
  for (const auto file : {kInstalledFile, kRevokedFile}) store_.remove_file(std::string(file) + ".new");
  for (const auto& name : generations_->names()) {
    if (name.ends_with(".new")) generations_->remove_file(name);
  }
  for (const auto& name : store_.names()) {
    if (name.starts_with(kStaging) && !is_held(store_, name)) store_.remove_tree(name);
  }
  std::set<std::string> wanted;
  try {
    wanted = listed();
  } catch (const Error&) {
    return;  // a kept list is damaged: rather keep files than lose some that it names
  }
  for (const auto& name : packages_->names()) {
    if (wanted.contains(name) || is_held(*packages_, name)) continue;
    // Out of sight first: a directory of this name is whole at all times.
    const std::string aside = std::string(kStaging) + "old-" + name.substr(0, 16);
    store_.remove_tree(aside);
    packages_->move(name, store_, aside);
    store_.remove_tree(aside);
  }
}

bool StoreChange::is_held(const DurableDirectory& parent, const std::string& name) const {
  const FileDescriptor directory{
      ::openat(parent.descriptor(), name.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC)};
  return directory && options_.os.flock(directory.number(), LOCK_EX | LOCK_NB) != 0;
}

void StoreChange::unpack(const IndexEntry& entry, const filesystem::path& path, const std::string& name) const {
  const FileDescriptor file = open_regular(AT_FDCWD, path, path);
  if (!file)
    throw Error(
        ErrorCode::NotFound,
        ErrorText{.what = "the package has gone", .where = path.string(), .next = "try again: it is fetched anew"});
  StagingSink sink{store_, name};
  const auto source = [&](char* buffer, std::size_t size) { return read_some(file.number(), buffer, size, path); };
  const PackageContents contents = read_package(source, path.filename().string(), sink, options_.limits);
  check_is(entry, contents, path);
  sink.finish();
}

}  // namespace fiona::marketplace
