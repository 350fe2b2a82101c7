#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <unistd.h>

#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/install.hpp>
#include <fiona/marketplace/store.hpp>

#include "support.hpp"

namespace fiona::marketplace {
namespace {

using namespace testing;
namespace filesystem = std::filesystem;

class StoreTest : public ::testing::Test {
 protected:
  void publish_one(const std::string& name, const std::string& version, std::string_view body = "code") {
    publish_plugin(scratch_.path(), market_, name, version, body);
  }
  void publish_as(const std::string& publisher, const std::string& name) {
    auto source = plugin_source(scratch_.path(), name, "1.0.0");
    source.manifest.replace(source.manifest.find("acme"), 4, publisher);
    pack_to(scratch_ / "other.fpk", source);
    publish(scratch_ / "other.fpk", market_);
  }
  void roll_back(std::optional<std::uint64_t> to = {}) {
    EXPECT_TRUE(apply(plan_rollback(to, Store{store_}), {}, store_));
  }
  InstallResult install_one(std::string_view request) { return install(request, Marketplace{market_}, store_); }

  Scratch scratch_;
  filesystem::path market_ = scratch_ / "market";
  filesystem::path store_ = scratch_ / "home/store";
};

TEST_F(StoreTest, AStoreThatDoesNotExistIsEmptyAndStaysSo) {
  EXPECT_TRUE(Store{store_}.installed().empty());
  EXPECT_FALSE(filesystem::exists(store_));
}

TEST_F(StoreTest, AnInstalledPackageIsFoundWithAllItsPlaces) {
  publish_one("steps", "1.0.0");
  EXPECT_EQ(install_one("steps").outcome, InstallOutcome::Installed);
  const InstalledPackage package = Store{store_}.find("acme/steps");
  EXPECT_EQ(Store{store_}.find("steps").directory, package.directory);
  EXPECT_TRUE(package.directory.is_absolute());
  EXPECT_EQ(file_content(package.library), library_bytes("code"));
  EXPECT_EQ(file_content(package.share / "data/map.osm"), "<osm/>");
  EXPECT_EQ(package.interface().components(0).name(), "steps");
  EXPECT_EQ(package.source, market_.string());
  EXPECT_NO_THROW(Store{store_}.verify(package));
}

TEST_F(StoreTest, AnUnknownNameIsToldWithTheNearest) {
  publish_one("steps", "1.0.0");
  install_one("steps");
  const Error error = error_of([&] { Store{store_}.find("stepps"); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_EQ(std::string(error.what()), store_.string() +
                                           ": there is no installed package stepps\n  did you mean: steps\n"
                                           "  next: market install stepps");
}

TEST_F(StoreTest, ANameOfTwoPublishersNeedsThePublisher) {
  publish_one("steps", "1.0.0");
  publish_as("umbrella", "steps");
  install_one("acme/steps");
  install_one("umbrella/steps");
  const Error error = error_of([&] { Store{store_}.find("steps"); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_EQ(error.text().what, "several publishers have a package steps");
  EXPECT_EQ(error.text().expected, "one of acme/steps, umbrella/steps");
  EXPECT_EQ(Store{store_}.find("umbrella/steps").manifest.publisher(), "umbrella");
}

TEST_F(StoreTest, InstallingAgainChangesNothing) {
  publish_one("steps", "1.0.0");
  install_one("steps");
  const auto before = snapshot(scratch_.path());
  EXPECT_EQ(install_one("steps").outcome, InstallOutcome::AlreadyInstalled);
  EXPECT_EQ(snapshot(scratch_.path()), before);
}

TEST_F(StoreTest, AnUpgradeReplacesAndTheOldFilesStayForARollback) {
  publish_one("steps", "1.0.0");
  const auto old = install_one("steps").package;
  publish_one("steps", "1.1.0", "new code");
  const InstallResult result = install_one("steps");
  EXPECT_EQ(result.outcome, InstallOutcome::Replaced);
  EXPECT_EQ(result.previous_version, "1.0.0");
  EXPECT_EQ(file_content(result.package.library), library_bytes("new code"));
  install_one("steps");
  EXPECT_TRUE(filesystem::exists(old.library));
  roll_back();
  EXPECT_EQ(Store{store_}.find("steps").directory, old.directory);
  EXPECT_NO_THROW(Store{store_}.verify(old));
}

TEST_F(StoreTest, RollbackGoesOnAndBackAgainByNumber) {
  for (const char* version : {"1.0.0", "2.0.0", "3.0.0"}) {
    publish_one("steps", version, version);
    install_one("steps");
  }
  roll_back();
  roll_back();
  EXPECT_EQ(Store{store_}.find("steps").manifest.version(), "1.0.0");
  const Error end = error_of([&] { roll_back(); });
  EXPECT_EQ(end.code(), ErrorCode::NotFound);
  EXPECT_EQ(end.text().what, "there is nothing to go back to");
  roll_back(3);
  EXPECT_EQ(Store{store_}.find("steps").manifest.version(), "3.0.0");
  const Error unknown = error_of([&] { roll_back(9); });
  EXPECT_EQ(unknown.text().what, "generation 9 of the store is not kept");
  EXPECT_EQ(unknown.text().expected, "one of 1, 2, 3");
}

TEST_F(StoreTest, AnEarlierVersionIsFoundWithWhatWasInstalledBesideItLast) {
  publish_one("steps", "1.0.0");
  const auto old = install_one("steps").package;
  publish_one("maps", "1.0.0");
  install_one("maps");
  publish_one("steps", "2.0.0", "new");
  install_one("steps");
  const auto with = Store{store_}.installed_with("acme/steps", "1.0.0");
  ASSERT_EQ(with.size(), 2u);
  EXPECT_EQ(with[0].name(), "acme/maps");
  EXPECT_EQ(with[1].directory, old.directory);
  EXPECT_TRUE(Store{store_}.installed_with("acme/steps", "3.0.0").empty());
}

TEST_F(StoreTest, AChangeAfterARollbackGetsANumberOfItsOwn) {
  publish_one("steps", "1.0.0");
  install_one("steps");
  publish_one("steps", "2.0.0", "new");
  install_one("steps");
  roll_back();
  publish_one("maps", "1.0.0");
  install_one("maps");
  const auto history = Store{store_}.history();
  ASSERT_EQ(history.size(), 3u);
  EXPECT_EQ(history[0].number, 3u);
  EXPECT_TRUE(history[0].present);
  EXPECT_EQ(history[0].change, "install maps");
  roll_back();
  EXPECT_EQ(Store{store_}.history()[2].present, true);
}

TEST_F(StoreTest, OnlyTenGenerationsAndTheirFilesAreKept) {
  for (int i = 1; i <= 14; ++i) {
    publish_one("steps", std::to_string(i) + ".0.0", std::to_string(i));
    install_one("steps");
  }
  EXPECT_EQ(Store{store_}.history().size(), 11u);  // the present one, and ten
  install_one("steps");
  EXPECT_EQ(std::distance(filesystem::directory_iterator(store_ / "packages"), {}), 11);
}

TEST_F(StoreTest, ARollbackToDamagedFilesIsRefused) {
  publish_one("steps", "1.0.0");
  const auto old = install_one("steps").package;
  publish_one("steps", "2.0.0", "new");
  install_one("steps");
  write_file(old.library, "evil");
  const Error error = error_of([&] { roll_back(); });
  EXPECT_EQ(error.code(), ErrorCode::BadSignature);
  EXPECT_EQ(error.text().what, "the files of acme/steps 1.0.0, to which this would go back, are damaged or gone");
  EXPECT_EQ(Store{store_}.find("steps").manifest.version(), "2.0.0");
}

TEST_F(StoreTest, ADamagedGenerationCostsNoFiles) {
  publish_one("steps", "1.0.0");
  const auto old = install_one("steps").package;
  publish_one("steps", "2.0.0", "new");
  install_one("steps");
  write_file(store_ / "generations/1.textproto", "packages {");
  install_one("steps");
  EXPECT_TRUE(filesystem::exists(old.library));
  EXPECT_EQ(Store{store_}.history()[1].fault.find("the list of installed packages is damaged"), 0u);
}

TEST_F(StoreTest, APackageThatIsHeldIsNotSwept) {
  publish_one("steps", "1.0.0");
  const auto old = install_one("steps").package;
  {
    const PackageHold hold = Store{store_}.hold(old);
    publish_one("steps", "1.1.0", "new code");
    install_one("steps");
    filesystem::remove_all(store_ / "generations");
    install_one("steps");
    EXPECT_EQ(file_content(old.library), library_bytes("code"));
  }
  install_one("steps");
  EXPECT_FALSE(filesystem::exists(old.directory));
  const Error error = error_of([&] { Store{store_}.hold(old); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_EQ(error.text().what, "acme/steps 1.0.0 is no longer installed");
}

TEST_F(StoreTest, AnOlderVersionIsInstalledOnlyWhenAskedForByNumber) {
  publish_one("steps", "1.0.0");
  publish_one("steps", "2.0.0-rc.1", "candidate");
  EXPECT_EQ(install_one("steps@2.0.0-rc.1").outcome, InstallOutcome::Installed);
  EXPECT_EQ(install_one("steps").outcome, InstallOutcome::AlreadyInstalled);
  EXPECT_EQ(install_one("steps@1.0.0").package.manifest.version(), "1.0.0");
}

TEST_F(StoreTest, ADamagedPackageIsNoticedAndRepaired) {
  publish_one("steps", "1.0.0");
  const auto package = install_one("steps").package;
  write_file(package.library, library_bytes("evil"));
  const Error error = error_of([&] { Store{store_}.verify(package); });
  EXPECT_EQ(error.code(), ErrorCode::BadSignature);
  EXPECT_EQ(error.text().what, "the installed package acme/steps is damaged: lib/libsteps.so has other content");
  EXPECT_EQ(error.text().next, "market install acme/steps@1.0.0 --from " + market_.string());
  EXPECT_EQ(install_one("steps").outcome, InstallOutcome::Repaired);
  EXPECT_NO_THROW(Store{store_}.verify(package));
}

TEST_F(StoreTest, VerifyNamesEachKindOfDamage) {
  publish_one("steps", "1.0.0");
  const auto package = install_one("steps").package;
  const auto damage = [&] {
    const std::string what = error_of([&] { Store{store_}.verify(package); }).text().what;
    return what.substr(what.find(": ") + 2);
  };
  write_file(package.share / "extra", "x");
  EXPECT_EQ(damage(), "share/extra does not belong to it");
  filesystem::remove(package.share / "extra");
  write_file(package.share / "help.txt", "longer");
  EXPECT_EQ(damage(), "share/help.txt has another size");
  filesystem::remove(package.share / "help.txt");
  EXPECT_EQ(damage(), "share/help.txt is missing");
  filesystem::create_symlink(package.library, package.share / "help.txt");
  EXPECT_EQ(damage(),
            "share/help.txt cannot be read: could not open it for reading: Too many levels of symbolic links");
  write_file(package.directory / "manifest.textproto", "junk");
  EXPECT_NE(damage().find("manifest.textproto:1:5: this is not a Manifest"), std::string::npos) << damage();
}

TEST_F(StoreTest, ADamagedListIsToldWithItsCure) {
  publish_one("steps", "1.0.0");
  install_one("steps");
  write_file(store_ / "installed.textproto", "packages { manifest {");
  const Error error = error_of([&] { Store{store_}.installed(); });
  EXPECT_EQ(error.text().what.find("the list of installed packages is damaged: this is not a Installed"), 0u);
  EXPECT_EQ(error.text().next, "move " + (store_ / "installed.textproto").string() +
                                   " away and install the packages again; earlier lists are in " +
                                   (store_ / "generations").string());
}

TEST_F(StoreTest, AListThatLeadsOutOfTheStoreIsRefused) {
  publish_one("steps", "1.0.0");
  install_one("steps");
  std::string list = file_content(store_ / "installed.textproto");
  const std::size_t at = list.find("packages/");
  write_file(store_ / "installed.textproto", list.replace(at, 9, "../../etc"));
  EXPECT_EQ(error_of([&] { Store{store_}.installed(); }).text().what,
            "the list of installed packages is damaged: acme/steps has no directory of this store");
}

TEST_F(StoreTest, ARemovedPackageIsGoneAndItsFilesAreSweptOnceNoGenerationHasThem) {
  publish_one("steps", "1.0.0");
  install_one("steps");
  publish_one("maps", "1.0.0");
  EXPECT_EQ(marketplace::remove("steps", store_).name(), "acme/steps");
  EXPECT_TRUE(Store{store_}.installed().empty());
  filesystem::remove_all(store_ / "generations");
  install_one("maps");
  EXPECT_EQ(std::distance(filesystem::directory_iterator(store_ / "packages"), {}), 1);
}

TEST_F(StoreTest, AnotherInstallationIsWaitedForAndThenTold) {
  publish_one("steps", "1.0.0");
  install_one("steps");
  const int other = ::open(store_.c_str(), O_RDONLY | O_DIRECTORY);
  ASSERT_EQ(::flock(other, LOCK_EX), 0);
  InstallOptions options;
  options.lock_wait = std::chrono::milliseconds(0);
  const Error error = error_of([&] { install("steps", Marketplace{market_}, store_, options); });
  EXPECT_EQ(error.code(), ErrorCode::Unreachable);
  EXPECT_EQ(error.text().what.find("process " + std::to_string(::getpid()) + " ("), 0u) << error.text().what;
  EXPECT_NE(error.text().what.find("marketplace_test"), std::string::npos);
  EXPECT_TRUE(error.text().what.ends_with(") is changing this directory and has not ended")) << error.text().what;
  std::string who;
  options.on_wait = [&](const std::string& holder) { ::close(other), who = holder; };
  options.lock_wait = std::chrono::seconds(10);
  install("steps", Marketplace{market_}, store_, options);
  EXPECT_TRUE(who.starts_with("process ")) << who;
}

TEST_F(StoreTest, TheDefaultStoreFollowsTheEnvironment) {
  ::setenv("FIONA_STORE", "/a", 1);
  ::setenv("XDG_DATA_HOME", "/b", 1);
  ::setenv("HOME", "/c", 1);
  EXPECT_EQ(Store::default_directory(), "/a");
  ::unsetenv("FIONA_STORE");
  EXPECT_EQ(Store::default_directory(), "/b/fiona/store");
  ::setenv("XDG_DATA_HOME", "relative", 1);
  EXPECT_EQ(Store::default_directory(), "/c/.local/share/fiona/store");
}

TEST_F(StoreTest, ADirectoryWithoutAnIndexIsNoMarketplace) {
  const Error error = error_of([&] { Marketplace{market_}; });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_EQ(std::string(error.what()), market_.string() +
                                           ": there is no marketplace here: it has no index.binpb\n"
                                           "  next: choose one with --from DIR, or set FIONA_MARKET");
}

TEST_F(StoreTest, ADamagedIndexIsTold) {
  write_file(market_ / "index.binpb", "not an index");
  EXPECT_EQ(error_of([&] { Marketplace{market_}; }).text().what,
            "the marketplace's index is damaged: it is not an index");
}

TEST_F(StoreTest, WhatAnOlderFionaDoesNotUnderstandHidesNothingElse) {
  publish_one("steps", "1.0.0");
  publish_one("maps", "1.0.0");
  Index index = Marketplace{market_}.index();
  index.mutable_entries(0)->mutable_manifest()->set_kind(static_cast<PackageKind>(9));
  const std::string other = full_name(index.entries(1).manifest());
  Revocation& revoked = *index.add_revoked();
  revoked.set_package("acme/nav");
  revoked.set_blake2b(index.entries(1).blake2b());
  index.add_revoked()->set_blake2b("of another kind");
  write_file(market_ / "index.binpb", index.SerializeAsString());
  const Marketplace market{market_};
  ASSERT_EQ(market.search({}).size(), 1u);
  EXPECT_EQ(full_name(market.search({})[0].manifest()), other);
  EXPECT_EQ(market.index().revoked_size(), 1);
  EXPECT_EQ(market.left_out(), 2u);
}

TEST_F(StoreTest, SearchFindsByAllWordsAndInfoTellsAllVersions) {
  publish_one("steps", "1.0.0");
  publish_one("steps", "1.10.0");
  publish_one("steps", "1.9.0");
  publish_one("maps", "1.0.0");
  const Marketplace market{market_};
  const auto found = market.search({"STEP", "counts"});
  ASSERT_EQ(found.size(), 2u);  // maps provides StepProvider too
  EXPECT_EQ(found[1].manifest().version(), "1.10.0");
  EXPECT_EQ(market.search({"acme/maps"}).size(), 1u);
  EXPECT_TRUE(market.search({"steps", "nonsense"}).empty());
  const auto versions = market.info("steps");
  ASSERT_EQ(versions.size(), 3u);
  EXPECT_EQ(versions[1].manifest().version(), "1.9.0");
  EXPECT_EQ(market.providers_of("fiona.localisation.StepProvider").size(), 2u);
  EXPECT_TRUE(market.providers_of("fiona.localisation.Step").empty());
}

TEST_F(StoreTest, AVersionThatIsNotThereIsToldWithThoseThatAre) {
  publish_one("steps", "1.0.0");
  const Error error = error_of([&] { install_one("steps@3.0.0"); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_EQ(error.text().what, "the marketplace has no such version of acme/steps");
  EXPECT_EQ(error.text().expected, "one of 1.0.0");
  EXPECT_EQ(error.text().found, "3.0.0");
  const Error unknown = error_of([&] { install_one("step"); });
  EXPECT_EQ(unknown.text().what, "the marketplace has no package step");
  EXPECT_EQ(unknown.text().near, std::vector<std::string>{"steps"});
  EXPECT_FALSE(filesystem::exists(store_));
}

TEST_F(StoreTest, APackageForAnotherMachineIsToldSo) {
  auto source = plugin_source(scratch_.path(), "steps", "1.0.0");
  std::string library = file_content(source.libraries[0]);
  library[18] = static_cast<char>(this_architecture() == "x86_64" ? 183 : 62);  // e_machine
  write_file(source.libraries[0], library);
  pack_to(scratch_ / "other.fpk", source);
  publish(scratch_ / "other.fpk", market_);
  const Error error = error_of([&] { install_one("steps"); });
  EXPECT_EQ(error.code(), ErrorCode::DependencyConflict);
  EXPECT_EQ(error.text().what, "acme/steps cannot be installed: acme/steps 1.0.0 is made for " +
                                   std::string(this_architecture() == "x86_64" ? "aarch64" : "x86_64") +
                                   ", and this machine is " + std::string(this_architecture()));
}

TEST_F(StoreTest, ABuildMayReplaceItsOwnVersion) {
  publish_one("steps", "1.0.0");
  install_one("steps");
  pack_to(scratch_ / "new.fpk", plugin_source(scratch_.path(), "steps", "1.0.0", "other"));
  publish(scratch_ / "new.fpk", market_, true);
  EXPECT_EQ(install_one("steps").outcome, InstallOutcome::Replaced);
}

TEST_F(StoreTest, APackageThatIsNotTheIndexedOneIsRefused) {
  publish_one("steps", "1.0.0");
  const Marketplace market{market_};
  pack_to(market_ / market.index().entries(0).file(), plugin_source(scratch_.path(), "steps", "1.0.0", "evil"));
  const Error error = error_of([&] { install("steps", market, store_); });
  EXPECT_EQ(error.code(), ErrorCode::BadSignature);
  EXPECT_EQ(error.text().what, "the package is not the one that the index describes");
  EXPECT_TRUE(Store{store_}.installed().empty());
  filesystem::remove(market_ / market.index().entries(0).file());
  EXPECT_EQ(error_of([&] { install("steps", market, store_); }).text().what,
            "the marketplace's index names a package that is not there");
}

}  // namespace
}  // namespace fiona::marketplace
