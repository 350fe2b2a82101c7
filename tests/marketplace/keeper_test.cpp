// Marketplaces of our own: how packages come into them, and what their users and keepers do not fall for.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <fiona/error.hpp>
#include <fiona/marketplace/install.hpp>
#include <fiona/marketplace/keeper.hpp>
#include <fiona/marketplace/open.hpp>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "../damage.hpp"
#include "durable.hpp"
#include "kept_market.hpp"

namespace fiona::marketplace {
namespace {

using ::testing::ElementsAre;
using testing::error_of;
using testing::file_content;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::write_file;

TEST_F(KeptMarket, ASignedPackageIsInstalled) {
  EXPECT_THAT(hand_in(packed("nav", "1.0.0")).packages, ElementsAre(HasSubstr("acme/nav-1.0.0-")));
  EXPECT_EQ(install_fault("nav"), "");
  EXPECT_NO_THROW(Store{scratch_ / "store"}.verify(Store{scratch_ / "store"}.find("nav")));
}

/// Several processes of a user have one place for copies.
TEST_F(KeptMarket, WhatAnotherProcessIsJustFetchingOrInstallingIsLeftToIt) {
  hand_in(packed("nav", "1.0.0"));
  EXPECT_EQ(install_fault("nav"), "");
  std::filesystem::path copy;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(user().copies)) {
    if (entry.path().filename() == "index.binpb") copy = entry.path().parent_path();
  }
  const auto old = copy / "old.fpk", fresh = copy / "fresh.fpk", half = copy / "other.fpk.new";
  for (const auto& file : {old, fresh, half}) write_file(file, "a package");
  std::filesystem::last_write_time(old, std::filesystem::file_time_type::clock::now() - std::chrono::hours(2));
  {
    const OsCalls os = system_calls();
    DurableDirectory fetching{os, copy, 0700};
    fetching.lock(std::chrono::seconds(1));
    open_marketplace(market_.string(), user());
    EXPECT_TRUE(std::filesystem::exists(half));
    EXPECT_TRUE(std::filesystem::exists(old)) << "who waits for nobody removes nothing";
  }
  open_marketplace(market_.string(), user());
  EXPECT_FALSE(std::filesystem::exists(half)) << "nobody fetches any more";
  EXPECT_FALSE(std::filesystem::exists(old));
  EXPECT_TRUE(std::filesystem::exists(fresh));
}

TEST_F(KeptMarket, SeveralVersionsAndPackagesLieSideBySide) {
  hand_in(packed("nav", "1.0.0"));
  hand_in(packed("map", "1.0.0"));
  hand_in(packed("nav", "1.1.0"));
  EXPECT_EQ(open_marketplace(market_.string(), user()).info("nav").size(), 2U);
  EXPECT_EQ(install_fault("map"), "");
  EXPECT_EQ(install_fault("nav@1.0.0"), "");
}

TEST_F(KeptMarket, ANewPublisherWaitsForTheKeepersWord) {
  const auto file = packed("nav", "1.0.0");
  sign_package(file, author());
  submit(file, market_, author());
  const Accepted accepted = accept(market_, {}, keeper());
  ASSERT_EQ(accepted.unknown.size(), 1U);
  EXPECT_EQ(accepted.unknown[0].name, "acme");
  EXPECT_EQ(accepted.unknown[0].key, author().keys.get("acme").open());
  EXPECT_THAT(install_fault("nav"), HasSubstr("the marketplace has no package nav"));
  EXPECT_FALSE(accept(market_, {acme()}, keeper()).packages.empty());
}

TEST_F(KeptMarket, ANewPublisherIsWelcomeWithTheKeyThatTheKeeperMeansAndNoOther) {
  keeper().keys.make("acme");
  const auto file = packed("nav", "1.0.0");
  sign_package(file, author());
  submit(file, market_, keeper());
  const Accepted accepted = accept(market_, {{"acme", keeper().keys.get("acme").open()}}, keeper());
  EXPECT_THAT(accepted.packages, IsEmpty());
  ASSERT_EQ(accepted.unknown.size(), 1U);
  EXPECT_EQ(accepted.unknown[0].key, acme().key);
  EXPECT_EQ(market_roles(market_, keeper()).size(), 3U) << "it delegates to nobody";
}

TEST_F(KeptMarket, AKnownPublisherNeedsNoWord) {
  hand_in(packed("nav", "1.0.0"));
  const auto file = packed("nav", "1.1.0");
  sign_package(file, author());
  submit(file, market_, author());
  EXPECT_EQ(accept(market_, {}, keeper()).packages.size(), 1U);
}

TEST_F(KeptMarket, AKnownPublisherWithAnotherKeyIsAskedAbout) {
  hand_in(packed("nav", "1.0.0"));
  KeeperOptions impostor = options("impostor", 0);
  impostor.keys.make("acme");
  const auto file = packed("nav", "6.6.6", "evil");
  sign_package(file, impostor);
  submit(file, market_, impostor);
  const Accepted accepted = accept(market_, {}, keeper());
  ASSERT_EQ(accepted.unknown.size(), 1U);
  EXPECT_TRUE(accepted.unknown[0].other_key);
  EXPECT_THAT(install_fault("nav@6.6.6"), HasSubstr("no such version"));
}

TEST_F(KeptMarket, AnUnsignedPackageIsNotHandedIn) {
  const auto file = packed("nav", "1.0.0");
  const Error error = error_of([&] { submit(file, market_, author()); });
  EXPECT_THAT(error.what(), HasSubstr("this package is not signed: there is no acme.json beside it"));
  EXPECT_THAT(error.what(), HasSubstr("fiona plugin sign"));
}

TEST_F(KeptMarket, WhereThereIsNoMarketplaceNothingIsHandedIn) {
  const auto file = packed("nav", "1.0.0");
  sign_package(file, author());
  const Error typo = error_of([&] { submit(file, scratch_ / "markte", author()); });
  EXPECT_EQ(typo.text().what, "there is no marketplace here: it has no metadata");
  EXPECT_FALSE(std::filesystem::exists(scratch_ / "markte"));
  const Error address = error_of([&] { submit(file, "https://example.org/market", author()); });
  EXPECT_EQ(address.code(), ErrorCode::NotAllowed);
  EXPECT_FALSE(std::filesystem::exists("https:"));
}

TEST_F(KeptMarket, ASignatureForAnotherContentIsNoSignature) {
  sign_package(packed("nav", "1.0.0"), author());
  const auto file = packed("nav", "1.0.0", "other code");
  EXPECT_THAT(error_of([&] { submit(file, market_, author()); }).what(),
              HasSubstr("acme.json does not sign for this package"));
}

TEST_F(KeptMarket, APublishedVersionKeepsItsContent) {
  hand_in(packed("nav", "1.0.0"));
  const Accepted accepted = hand_in(packed("nav", "1.0.0", "other code"));
  EXPECT_THAT(texts(accepted.refused), ElementsAre(HasSubstr("is published already, with other content")));
  EXPECT_EQ(install_fault("nav"), "");
}

TEST_F(KeptMarket, WhatWasSignedAndNeverPublishedIsTakenOff) {
  sign_package(packed("nav", "1.1.0"), author());
  EXPECT_THAT(texts(hand_in(packed("nav", "1.1.1")).refused),
              ElementsAre(AllOf(HasSubstr("acme.json: it signs for acme/nav-1.1.0-"), HasSubstr("has not come with it"),
                                HasSubstr("fiona plugin unsign acme/nav@1.1.0, then fiona plugin sign FILE"))));
  unsign_package("acme/nav@1.1.0", author());
  EXPECT_THAT(hand_in(packed("nav", "1.1.1")).packages, ElementsAre(HasSubstr("acme/nav-1.1.1-")));
  sign_package(packed("nav", "1.2.0"), author());  // and now that something is published
  EXPECT_THAT(texts(hand_in(packed("nav", "1.2.1")).refused),
              ElementsAre(HasSubstr("or sign without it: fiona plugin sign FILE after=" +
                                    (market_ / "metadata/3.acme.json").string())));
  sign_package(packed("nav", "1.2.1"), author(), market_ / "metadata/3.acme.json");
  submit(scratch_ / "out/nav-1.2.1.fpk", market_, author());
  EXPECT_THAT(accept(market_, {}, keeper()).packages, ElementsAre(HasSubstr("acme/nav-1.2.1-")));
  EXPECT_EQ(install_fault("nav@1.1.1"), "") << "nothing was withdrawn";
}

TEST_F(KeptMarket, WhoHasPackedAPublishedVersionAgainRaisesItAndSignsAfterWhatIsThere) {
  hand_in(packed("nav", "1.0.0"));
  EXPECT_THAT(
      texts(hand_in(packed("nav", "1.0.0", "other code")).refused),
      ElementsAre(AllOf(HasSubstr("is published already, with other content"),
                        HasSubstr("fiona plugin sign FILE after=" + (market_ / "metadata/1.acme.json").string()))));
  sign_package(packed("nav", "1.0.1", "other code"), author(), market_ / "metadata/1.acme.json");
  submit(scratch_ / "out/nav-1.0.1.fpk", market_, author());
  EXPECT_THAT(accept(market_, {}, keeper()).packages, ElementsAre(HasSubstr("acme/nav-1.0.1-")));
  EXPECT_EQ(install_fault("nav@1.0.0"), "");
}

TEST_F(KeptMarket, WhatIsNotSignedForIsNotTakenOffAndNamedWithWhatIs) {
  sign_package(packed("nav-2", "1.1.0-rc.1"), author());
  const Error error = error_of([&] { unsign_package("acme/nav-2@1.1.0", author()); });
  EXPECT_EQ(error.text().what, "the key of acme has not signed for acme/nav-2@1.1.0");
  EXPECT_EQ(error.text().expected, "one of acme/nav-2@1.1.0-rc.1");
  EXPECT_EQ(error_of([&] { unsign_package("acme/nav-2", author()); }).code(), ErrorCode::Usage);
}

TEST_F(KeptMarket, WhoSignsSeveralAtOnceSignsForAll) {
  std::vector<std::filesystem::path> files;
  for (int i = 0; i < 8; ++i) {
    const auto file = packed("nav", "1." + std::to_string(i) + ".0"),
               own = scratch_ / std::to_string(i) / file.filename();
    std::filesystem::create_directories(own.parent_path());
    std::filesystem::rename(file, own);
    files.push_back(own);
  }
  {
    std::vector<std::jthread> threads;
    for (const auto& file : files) threads.emplace_back([&] { sign_package(file, author()); });
  }
  const auto role = tuf::read_role(*author().keys.signed_role("acme"), acme().key, "acme.json");
  EXPECT_EQ(role.version, 8);
  EXPECT_EQ(role.targets.size(), 8U);
  for (const auto& file : files) EXPECT_NO_THROW(submit(file, market_, author())) << "in whatever order";
  EXPECT_EQ(accept(market_, {acme()}, keeper()).packages.size(), 8U);
}

TEST_F(KeptMarket, WhatWasSignedEarlierDoesNotTakeThePlaceOfWhatWasSignedLater) {
  sign_package(packed("nav", "1.0.0"), author());
  std::filesystem::copy(author().keys.path() / "acme.json", scratch_ / "old.json");
  const auto old = packed("map", "1.0.0");
  sign_package(packed("nav", "1.1.0"), author());
  submit(scratch_ / "out/nav-1.1.0.fpk", market_, author());
  std::filesystem::copy(scratch_ / "old.json", author().keys.path() / "acme.json",
                        std::filesystem::copy_options::overwrite_existing);  // as on another machine
  sign_package(old, author());
  const Error error = error_of([&] { submit(old, market_, author()); });
  EXPECT_EQ(error.text().what, "what was signed later waits there already, and does not sign for this package");
  EXPECT_EQ(error.text().next, "fiona plugin sign FILE after=" + (market_ / "incoming/acme.json").string());
  sign_package(old, author(), market_ / "incoming/acme.json");
  submit(old, market_, author());
  submit(scratch_ / "out/nav-1.0.0.fpk", market_, author());
  EXPECT_EQ(accept(market_, {acme()}, keeper()).packages.size(), 3U);
}

TEST_F(KeptMarket, APackageThatNobodySignsForIsToldOfAndOneThatIsThereIsNot) {
  hand_in(packed("nav", "1.0.0"));
  submit(packed("nav", "1.0.0"), market_, author());  // once more
  std::filesystem::copy(packed("map", "1.0.0"), market_ / "incoming/map.fpk");
  EXPECT_THAT(texts(accept(market_, {}, keeper()).refused),
              ElementsAre(HasSubstr("map.fpk: its publisher does not sign for it")));
  EXPECT_FALSE(std::filesystem::exists(market_ / "incoming/acme.json"));
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(market_ / "incoming"), {}), 1);
}

TEST_F(KeptMarket, APackageThatWasSwappedInIncomingIsRefused) {
  const auto file = packed("nav", "1.0.0");
  sign_package(file, author());
  submit(file, market_, author());
  const auto evil = packed("nav", "1.0.0", "evil");
  for (const auto& entry : std::filesystem::directory_iterator(market_ / "incoming")) {
    if (entry.path().extension() == ".fpk")
      std::filesystem::copy_file(evil, entry.path(), std::filesystem::copy_options::overwrite_existing);
  }
  EXPECT_THAT(texts(accept(market_, {acme()}, keeper()).refused), ElementsAre(HasSubstr("which has not come with it")));
}

TEST_F(KeptMarket, ATamperedPackageIsNotInstalled) {
  hand_in(packed("nav", "1.0.0"));
  std::string bytes = file_content(target(".fpk"));
  bytes.back() ^= 1;
  write_file(target(".fpk"), bytes);
  EXPECT_THAT(install_fault("nav"), HasSubstr("is not the one that was signed for: it has another sha256"));
}

TEST_F(KeptMarket, ATamperedIndexIsNotRead) {
  hand_in(packed("nav", "1.0.0"));
  for (const auto& entry : std::filesystem::directory_iterator(market_ / "targets")) {
    if (entry.path().extension() != ".binpb" || entry.file_size() == 0) continue;
    std::string bytes = file_content(entry.path());
    bytes[20] ^= 1;
    write_file(entry.path(), bytes);
  }
  EXPECT_THAT(install_fault("nav"), HasSubstr("index.binpb is not the one that was signed for"));
  EXPECT_THAT(error_of([&] { accept(market_, {}, keeper()); }).what(),
              HasSubstr("index is not the one that was signed"));
}

TEST_F(KeptMarket, ChangedMetadataIsNotSignedByTheKeeper) {
  hand_in(packed("nav", "1.0.0"));
  for (const auto& entry : std::filesystem::directory_iterator(market_ / "metadata")) {
    if (!entry.path().string().ends_with("targets.json")) continue;
    auto file = nlohmann::json::parse(file_content(entry.path()));
    file["signed"]["delegations"]["roles"][0]["paths"] = {"*"};
    write_file(entry.path(), file.dump());
  }
  accept(market_, {}, keeper());  // goes by what he has seen himself
  EXPECT_THAT(install_fault("nav"), HasSubstr("mix and match: targets.json has not the"));
}

TEST_F(KeptMarket, AChangedRoleOfAPublisherIsNotSignedByTheKeeper) {
  hand_in(packed("nav", "1.0.0"));
  for (const auto& entry : std::filesystem::directory_iterator(market_ / "metadata")) {
    if (!entry.path().string().ends_with(".fiona.index.json")) continue;
    auto file = nlohmann::json::parse(file_content(entry.path()));
    file["signed"]["targets"]["index.binpb"]["hashes"]["sha256"] = std::string(64, '0');
    write_file(entry.path(), file.dump());
  }
  EXPECT_THAT(error_of([&] { accept(market_, {}, keeper()); }).what(), HasSubstr("mix and match: "));
}

TEST_F(KeptMarket, IsTheSameWithASlashAtItsEnd) {
  const auto file = packed("nav", "1.0.0");
  sign_package(file, author());
  submit(file, market_ / "", author());
  EXPECT_TRUE(keeps(market_ / "", keeper()));
  EXPECT_EQ(accept(market_ / "", {acme()}, keeper()).packages.size(), 1U);
  rotate(market_ / "", "online", {}, 1, keeper());
  EXPECT_EQ(install_fault("nav"), "");
}

TEST_F(KeptMarket, ASecondOneOfTheSameNameHasKeysOfItsOwn) {
  EXPECT_EQ(init_market(scratch_ / "other/market/", keeper()).keys, "market-2");
  EXPECT_NO_THROW(accept(market_, {}, keeper()));
  EXPECT_NO_THROW(accept(scratch_ / "other/market", {}, keeper()));
}

TEST_F(KeptMarket, WhatCannotBeMadeLeavesNoKeys) {
  const KeeperOptions other = options("other", 0);
  write_file(scratch_ / "file", "");
  error_of([&] { init_market(scratch_ / "file/market", other); });
  EXPECT_THAT(other.keys.names(), IsEmpty());
  EXPECT_EQ(init_market(scratch_ / "2 Markets", other).keys, "market2-markets");
}

TEST_F(KeptMarket, NobodyElseAccepts) {
  const auto file = packed("nav", "1.0.0");
  sign_package(file, author());
  submit(file, market_, author());
  KeeperOptions stranger = options("stranger", 0);
  stranger.trusted = scratch_ / "stranger-trusted";
  tuf::Client::trust(stranger.trusted, root_);
  EXPECT_THAT(error_of([&] { accept(market_, {acme()}, stranger); }).what(),
              HasSubstr("this user has not the keys of this marketplace"));
  EXPECT_FALSE(keeps(market_, author()));
  EXPECT_TRUE(keeps(market_, keeper()));
}

TEST_F(KeptMarket, AMarketplaceThatNobodyTrustsIsNotOpened) {
  OpenOptions stranger = user();
  stranger.trusted = scratch_ / "stranger-trusted";
  const Error error = error_of([&] { open_marketplace(market_.string(), stranger); });
  EXPECT_THAT(error.what(), HasSubstr("nobody has said that this marketplace is to be trusted"));
  EXPECT_THAT(error.what(), HasSubstr("fiona keys trust ROOT.json --from"));
}

TEST_F(KeptMarket, ExpiredMetadataStopsInstallationsNotWhatIsInstalled) {
  hand_in(packed("nav", "1.0.0"));
  hand_in(packed("map", "1.0.0"));
  EXPECT_EQ(install_fault("nav"), "");
  EXPECT_THAT(install_fault("map", 31), HasSubstr("freeze: timestamp.json has expired"));
  const Store store{scratch_ / "store"};
  EXPECT_NO_THROW(store.verify(store.find("nav")));
}

TEST_F(KeptMarket, AcceptingNothingSignsTheTimeAnew) {
  hand_in(packed("nav", "1.0.0"));
  EXPECT_THAT(accept(market_, {}, keeper(25)).packages, IsEmpty());
  EXPECT_EQ(install_fault("nav", 50), "");
}

TEST_F(KeptMarket, AKeeperWhoWasAwayTooLongCanSignAgain) {
  hand_in(packed("nav", "1.0.0"));
  EXPECT_NO_THROW(accept(market_, {}, keeper(100)));
  EXPECT_EQ(install_fault("nav", 100), "");
}

TEST_F(KeptMarket, WhatOthersHaveToSignAgainIsToldBeforeItEnds) {
  hand_in(packed("nav", "1.0.0"));
  const auto ending = [&](int on_day) {
    std::string text;
    for (const auto& one : accept(market_, {}, keeper(on_day)).ending)
      text += one.name + " " + one.until.substr(0, 10) + (one.has_ended ? " ended " : " ");
    return text;
  };
  EXPECT_EQ(ending(300), "");
  EXPECT_EQ(ending(340), "acme 2031-01-01 ");
  EXPECT_EQ(ending(366), "acme 2031-01-01 ended ");
  for (const char* key : {"market.root.key", "market.targets.key"}) std::filesystem::remove(keeper().keys.path() / key);
  EXPECT_EQ(ending(1070), "root 2033-01-01 targets 2031-10-28 ended acme 2031-01-01 ended ");
}

TEST_F(KeptMarket, AClockSetBackRevivesNothing) {
  hand_in(packed("nav", "1.0.0"));
  const auto old_market = scratch_ / "old";
  std::filesystem::copy(market_, old_market, std::filesystem::copy_options::recursive);
  hand_in(packed("nav", "1.1.0"));
  EXPECT_EQ(install_fault("nav", 10), "");
  std::filesystem::remove_all(market_);
  std::filesystem::rename(old_market, market_);
  EXPECT_THAT(install_fault("nav@1.0.0", 0), HasSubstr("rollback: timestamp.json is older"));
}

/// What the user has seen last, of a marketplace that is new, or shown as it was before.
class LastSeen : public KeptMarket {
 protected:
  void SetUp() override {
    KeptMarket::SetUp();
    hand_in(packed("nav", "1.0.0"));
    std::filesystem::copy(market_, old_, std::filesystem::copy_options::recursive);
    hand_in(packed("nav", "1.1.0"));
    ASSERT_EQ(install_fault("nav", 10), "");
    for (const auto& file : std::filesystem::directory_iterator(trusted())) {
      if (file.path().extension() == ".json") seen_[file.path().filename()] = file_content(file.path());
    }
  }
  std::filesystem::path trusted() const {
    return std::filesystem::directory_iterator(scratch_ / "user/trusted")->path();
  }
  /// All as it was seen, but for this file.
  void damage(const std::string& name, const std::string& content) const {
    for (const auto& [each, before] : seen_) write_file(trusted() / each, each == name ? content : before);
  }
  std::optional<Error> fault_of_opening() const {
    try {
      open_marketplace(market_.string(), user(10));
      return std::nullopt;
    } catch (const Error& error) {
      return error;
    }
  }
  void swap_markets() const {
    std::filesystem::rename(market_, scratch_ / "aside");
    std::filesystem::rename(old_, market_);
    std::filesystem::rename(scratch_ / "aside", old_);
  }

  const std::filesystem::path old_ = scratch_ / "old";
  std::map<std::string, std::string> seen_;
};

TEST_F(LastSeen, DamagedInAnyFileRevivesNothingAndIsMendedOrToldOfTheRoot) {
  ASSERT_GE(seen_.size(), 5U) << "root, timestamp, snapshot, targets, acme";
  tests::Damage damaged(20);
  const auto fault_in_time = [&] { return damaged.in_time([&] { return fault_of_opening(); }); };
  std::size_t told = 0, mended = 0;
  for (const auto& [name, whole] : seen_) {
    std::vector<std::string> contents{"", whole.substr(0, whole.size() - 1), std::string(whole.size(), '\0')};
    for (int i = 0; i < damaged.times(); ++i) {
      contents.push_back(damaged.cut(whole));
      contents.push_back(damaged.flipped(whole));
    }
    for (const std::string& content : contents) {
      swap_markets();
      damage(name, content);
      EXPECT_TRUE(fault_in_time().has_value()) << name << " with " << content.size() << " bytes: the old is taken";
      swap_markets();
      damage(name, content);
      const auto fault = fault_in_time();
      (fault ? told : mended)++;
      if (fault) {
        EXPECT_EQ(name, "root.json") << fault->what();
        EXPECT_NE(fault->text().where + fault->text().next, "");
        continue;
      }
      swap_markets();
      EXPECT_TRUE(fault_in_time().has_value()) << name << ": the old is taken once the new was seen again";
      swap_markets();
    }
  }
  const auto of_a_file = static_cast<std::size_t>(2 * damaged.times() + 3);
  EXPECT_GT(told, of_a_file * 3 / 4) << "of the root";
  EXPECT_GE(mended, (seen_.size() - 1) * of_a_file);
}

TEST_F(KeptMarket, WhatAPublisherNoLongerSignsForIsWithdrawn) {
  hand_in(packed("nav", "1.0.0"));
  KeeperOptions own = author();
  std::filesystem::remove(own.keys.path() / "acme.json");
  for (int i = 0; i < 2; ++i) hand_in(packed("map", "1." + std::to_string(i) + ".0"));  // version 2 again: newer than 1
  EXPECT_THAT(install_fault("nav"), HasSubstr("the marketplace has no package nav"));
  EXPECT_EQ(target("nav-1.0.0-x86_64.fpk"), "");
}

TEST_F(KeptMarket, KeysArePrivateAndAKeyThatIsNotIsRefused) {
  for (const auto& name : keeper().keys.names()) {
    struct stat status {};
    ASSERT_EQ(::stat((keeper().keys.path() / (name + ".key")).c_str(), &status), 0);
    EXPECT_EQ(status.st_mode & 0777, 0600U) << name;
  }
  ::chmod((keeper().keys.path() / "market.online.key").c_str(), 0644);
  EXPECT_THAT(error_of([&] { accept(market_, {}, keeper()); }).what(),
              HasSubstr("the signing key is not private to this user"));
}

TEST_F(KeptMarket, NoPrivateKeyIsInTheMarketplace) {
  for (const auto& entry : std::filesystem::recursive_directory_iterator(market_)) {
    if (!entry.is_regular_file()) continue;
    const std::string content = file_content(entry.path());
    for (const auto& name : keeper().keys.names()) {
      EXPECT_EQ(content.find(keeper().keys.get(name).seed()), std::string::npos) << entry.path();
    }
  }
}

TEST_F(KeptMarket, MetadataDoesNotGrowWithEachSignature) {
  for (int i = 0; i < 10; ++i) accept(market_, {}, keeper(i));
  std::size_t files = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(market_ / "metadata")) ++files;
  EXPECT_LE(files, 10U);
}

TEST_F(KeptMarket, ABuildsMarketplaceHoldsWhatItIsMadeOf) {
  KeeperOptions build = options("build", 0);
  const auto market = scratch_ / "built";
  make_market({packed("nav", "1.0.0"), packed("map", "1.0.0")}, market, build);
  std::filesystem::copy_file(packed("nav", "1.0.0", "of a build that was cut off"), market / "incoming/left.fpk");
  make_market({packed("nav", "1.0.0", "rebuilt")}, market, build);
  EXPECT_TRUE(std::filesystem::is_empty(market / "incoming"));
  trust_marketplace(file_content(scratch_ / "built.root.json"), market.string(), user());
  const Marketplace opened = open_marketplace(market.string(), user());
  EXPECT_EQ(opened.search({}).size(), 1U);
  EXPECT_NO_THROW(install("nav", opened, scratch_ / "store"));
}

TEST_F(KeptMarket, ABuildsMarketplaceThatIsDamagedIsMadeAnew) {
  KeeperOptions build = options("build", 0);
  const auto market = scratch_ / "built";
  make_market({packed("nav", "1.0.0")}, market, build);
  write_file(market / "metadata/timestamp.json", "{}");
  make_market({packed("nav", "1.0.0")}, market, build);
  trust_marketplace(file_content(scratch_ / "built.root.json"), market.string(), user());
  EXPECT_EQ(open_marketplace(market.string(), user()).search({}).size(), 1U);
}

}  // namespace
}  // namespace fiona::marketplace
