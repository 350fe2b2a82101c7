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

}  // namespace

std::string init_market(const filesystem::path& market, const KeeperOptions& options) {
  const tuf::RepositoryOptions how = repository_options(market, options);
  std::error_code failure;
  if (filesystem::exists(how.directory / "metadata", failure)) {
    throw Error(ErrorCode::NotAllowed, ErrorText{.what = "there is a marketplace here already",
                                                 .where = how.directory.string(),
                                                 .next = "choose another directory"});
  }
  const std::string name = how.directory.filename().string();
  const auto key = [&](const std::string& of) {
    const auto names = options.keys.names();
    const bool again = options.replace && std::ranges::find(names, name + of) != names.end();
    return again ? options.keys.get(name + of) : options.keys.make(name + of);
  };
  const tuf::SigningKey root = key(".root"), targets = key(".targets"), online = key(".online");
  tuf::Repository::create(how, root, targets, online);
  const OsCalls os = system_calls();
  const DurableDirectory directory{os, how.directory, 0755};
  directory.child("incoming", 0755);
  tuf::Repository repository{how, options.keys};
  repository.delegate(std::string(kIndexRole), {online.open()}, {std::string(kIndexFile)});
  directory.child("targets", 0755).replace(tuf::sha256_hex("") + "." + std::string(kIndexFile), "");
  repository.set_target(std::string(kIndexRole), std::string(kIndexFile), 0, tuf::sha256_hex(""));
  repository.commit();
  return repository.root();
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
  for (const auto& package : packages) {
    const ReadPackage read = read_for_keeping(package, options);
    copy_checked(package, read.sha256, incoming, read.entry.file());
    by_publisher[read.entry.manifest().publisher()].push_back(read);
  }
  std::vector<Welcome> publishers;
  for (const auto& [publisher, read] : by_publisher) {
    const auto names = options.keys.names();
    if (std::ranges::find(names, publisher) == names.end()) options.keys.make(publisher);
    incoming.replace(publisher + ".json", signed_role(publisher, read, true, options));
    publishers.push_back({publisher, options.keys.get(publisher).open()});
  }
  const Accepted accepted = accept(market, publishers, options);
  if (!accepted.refused.empty())
    throw Error(ErrorCode::Failed, {.what = accepted.refused.front().what,
                                    .where = (market / "incoming" / accepted.refused.front().file).string(),
                                    .next = "mend it, and make the marketplace again"});
  const filesystem::path place = filesystem::absolute(market).lexically_normal();
  const std::string root = tuf::Repository{repository_options(market, options), options.keys}.root();
  DurableDirectory{os, place.parent_path(), 0755}.replace(place.filename().string() + ".root.json", root);
}

}  // namespace fiona::marketplace
