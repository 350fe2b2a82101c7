#include <algorithm>
#include <fiona/error.hpp>
#include <fiona/marketplace/keeper.hpp>
#include <map>

#include "durable.hpp"
#include "index_file.hpp"
#include "keeper_packages.hpp"
#include "keeper_parts.hpp"
#include "signed_market.hpp"
#include "tuf/digest.hpp"

namespace fiona::marketplace {
namespace {

namespace filesystem = std::filesystem;

bool has_key(const std::string& name, const KeeperOptions& options) {
  const auto names = options.keys.names();
  return std::ranges::find(names, name) != names.end();
}

// Another marketplace of the same last name has its keys already: these get a number. A build goes on with its own.
std::string keys_name(const filesystem::path& place, const KeeperOptions& options) {
  const std::string base = key_name_of(place);
  std::string name = base;
  const auto is_taken = [&] {
    return has_key(name + ".root", options) || has_key(name + ".targets", options) ||
           has_key(name + ".online", options);
  };
  for (int number = 2; !options.replace && is_taken(); ++number) name = base + "-" + std::to_string(number);
  return name;
}

}  // namespace

NewMarket init_market(const filesystem::path& market, const KeeperOptions& options) {
  const tuf::RepositoryOptions how = repository_options(market, options);
  std::error_code failure;
  if (filesystem::exists(how.directory / "metadata", failure)) {
    throw Error(ErrorCode::NotAllowed, ErrorText{.what = "there is a marketplace here already",
                                                 .where = how.directory.string(),
                                                 .next = "choose another directory"});
  }
  // Before the keys: where no directory can be made, none are left.
  const OsCalls os = system_calls();
  const DurableDirectory directory{os, how.directory, 0755};
  directory.child("incoming", 0755);
  const DurableDirectory target_files = directory.child("targets", 0755);
  const std::string name = keys_name(how.directory, options);
  const auto key = [&](const std::string& of) {
    return has_key(name + of, options) ? options.keys.get(name + of) : options.keys.make(name + of);
  };
  const tuf::SigningKey root = key(".root"), targets = key(".targets"), online = key(".online");
  tuf::Repository::create(how, root, targets, online);
  tuf::Repository repository{how, options.keys};
  repository.delegate(std::string(kIndexRole), {online.open()}, {std::string(kIndexFile)});
  target_files.replace(tuf::sha256_hex("") + "." + std::string(kIndexFile), "");
  repository.set_target(std::string(kIndexRole), std::string(kIndexFile), 0, tuf::sha256_hex(""));
  repository.commit();
  return {repository.root(), name};
}

void make_market(const std::vector<filesystem::path>& packages, const filesystem::path& market, KeeperOptions options) {
  options.replace = true;
  bool kept = false;
  try {
    kept = keeps(market, options);
  } catch (const Error&) {
    // What is there is damaged, or of other keys: it is made anew below.
  }
  if (!kept) {
    for (const char* part : {"metadata", "targets", "incoming"}) filesystem::remove_all(market / part);
    filesystem::remove_all(repository_options(market, options).trusted);
    init_market(market, options);
  }
  std::map<std::string, std::vector<ReadPackage>> by_publisher;
  const OsCalls os = system_calls();
  const DurableDirectory incoming{os, filesystem::absolute(market) / "incoming", 0755};
  for (const auto& left : incoming.names()) incoming.remove_file(left);  // by a build that was cut off
  for (const auto& package : packages) {
    const ReadPackage read = read_for_keeping(package, options);
    copy_checked(package, read.sha256, incoming, read.entry.file());
    by_publisher[read.entry.manifest().publisher()].push_back(read);
  }
  std::vector<Welcome> publishers;
  for (const auto& [publisher, read] : by_publisher) {
    if (!has_key(publisher, options)) options.keys.make(publisher);
    incoming.replace(publisher + ".json", signed_role(publisher, read, true, options));
    publishers.push_back({publisher, options.keys.get(publisher).open()});
  }
  const Accepted accepted = accept(market, publishers, options);
  if (!accepted.refused.empty())
    throw Error(ErrorCode::Failed, {.what = accepted.refused.front().what,
                                    .where = (market / "incoming" / accepted.refused.front().file).string(),
                                    .next = "mend it, and make the marketplace again"});
  const filesystem::path place = place_of(market);
  const std::string root = tuf::Repository{repository_options(market, options), options.keys}.root();
  DurableDirectory{os, place.parent_path(), 0755}.replace(place.filename().string() + ".root.json", root);
}

}  // namespace fiona::marketplace
