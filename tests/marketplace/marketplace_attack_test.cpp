// Attacks on a marketplace, its users and their stores, each by its name, each refused for the right reason.
#include <gmock/gmock.h>

#include <limits>

#include "kept_market.hpp"
#include "tuf/role_file.hpp"

namespace fiona::marketplace {
namespace {

using ::testing::ElementsAre;
using testing::error_of;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using testing::write_file;

class MarketplaceAttack : public KeptMarket {
 protected:
  void SetUp() override {
    KeptMarket::SetUp();
    hand_in(packed("steps", "1.0.0"));
  }
  Store store() const { return Store{scratch_ / "store"}; }
  std::vector<tuf::OpenKey> root_keys() const { return market_roles(market_, keeper())[0].keys.keys; }
  std::string verify_fault(const std::string& name) const {
    return error_of([&] { store().verify(store().find(name)); }).what();
  }
};

// ---- names that stand for somebody else ----

TEST_F(MarketplaceAttack, PublisherUnderTheNameOfTheFirstPartyInAnotherMarketplace) {
  options("mallory", 0).keys.make("fiona");
  auto source = testing::plugin_source(scratch_ / "source", "steps", "1.0.0");
  source.manifest.replace(source.manifest.find("acme"), 4, "fiona");
  std::filesystem::create_directories(scratch_ / "out");
  const auto file = scratch_ / "out/first.fpk";
  pack_to(file, source);
  sign_package(file, options("mallory", 0));
  submit(file, market_, options("mallory", 0));
  accept(market_, {{"fiona", options("mallory", 0).keys.get("fiona").open()}}, keeper());
  const Marketplace market = open_marketplace(market_.string(), user());
  EXPECT_TRUE(plan_install({"fiona/steps"}, market, store()).needs_consent());
  install("fiona/steps", market, scratch_ / "store");
  EXPECT_FALSE(store().find("fiona/steps").first_party);
}

TEST_F(MarketplaceAttack, PublisherUnderTheNameOfAKnownOneInAnotherMarketplace) {
  hand_in(packed("steps", "1.0.0"));
  ASSERT_EQ(install_fault("steps"), "");
  const auto other = scratch_ / "other-market";
  trust_marketplace(init_market(other, options("mallory", 0)).root, other.string(), user());
  options("mallory", 0).keys.make("acme");
  const auto file = packed("steps", "9.0.0");
  sign_package(file, options("mallory", 0));
  submit(file, other, options("mallory", 0));
  accept(other, {{"acme", options("mallory", 0).keys.get("acme").open()}}, options("mallory", 0));
  const Plan plan = plan_install({"steps"}, open_marketplace(other.string(), user()), store());
  EXPECT_THAT(plan.steps[0].new_keys, SizeIs(1));
  EXPECT_TRUE(plan.needs_consent());
}

TEST_F(MarketplaceAttack, PublisherNamedAsARoleOfTheMarketplace) {
  for (const std::string name : {"root", "targets", "snapshot", "timestamp", "local", "unsigned"}) {
    EXPECT_THAT(error_of([&] {
                  parse_manifest("publisher: '" + name + "' name: 'x' version: '1.0.0' summary: 's' license: 'MIT'",
                                 "manifest.textproto");
                })
                    .text()
                    .what,
                HasSubstr("has a meaning of its own"));
    testing::write_file(market_ / "incoming" / (name + ".json"),
                        tuf::next_role(std::nullopt, author().keys.get("acme"), {}, true, day(100)));
    EXPECT_THAT(accept(market_, {{name, acme().key}}, keeper()).refused, SizeIs(1)) << name;
    std::filesystem::remove(market_ / "incoming" / (name + ".json"));
  }
}

TEST_F(MarketplaceAttack, MarketplaceThatRevokesWhatAnotherHasBrought) {
  ASSERT_EQ(install_fault("steps"), "");
  const auto other = scratch_ / "other-market";
  trust_marketplace(init_market(other, options("mallory", 0)).root, other.string(), user());
  const auto file = scratch_ / "out/steps-1.0.0.fpk";
  sign_package(file, author());
  submit(file, other, author());
  accept(other, {acme()}, options("mallory", 0));
  revoke(other, "acme/steps", "we do not like it", options("mallory", 0));
  EXPECT_THAT(note_revocations(open_marketplace(other.string(), user()), scratch_ / "store"), IsEmpty());
  EXPECT_NO_THROW(store().require_not_revoked(store().find("steps")));
}

TEST_F(MarketplaceAttack, RevokedVersionPublishedAgain) {
  revoke(market_, "acme/steps@1.0.0", "it counts backwards", keeper());
  for (const auto& [body, other] : {std::pair{"code", "nav"}, {"other code", "maps"}}) {
    const auto steps = packed("steps", "1.0.0", body), file = packed(other, "1.0.0");
    sign_package(steps, author());
    sign_package(file, author());
    submit(steps, market_, author());
    submit(file, market_, author());
    const Accepted accepted = accept(market_, {}, keeper());
    EXPECT_THAT(texts(accepted.refused),
                ElementsAre(HasSubstr("acme/steps 1.0.0 has been revoked: it counts backwards")));
    EXPECT_THAT(accepted.packages, ElementsAre(HasSubstr(other)));
    EXPECT_EQ(install_fault(other), "");
    EXPECT_THAT(install_fault("steps"), HasSubstr("no package steps"));
  }
}

TEST_F(MarketplaceAttack, PublisherUnderTheNameOfAKeyOfTheKeeper) {
  keeper().keys.make("acme");
  const KeeperOptions impostor = options("impostor", 0);
  impostor.keys.make("acme");
  const auto file = packed("nav", "6.6.6", "evil");
  sign_package(file, impostor);
  submit(file, market_, impostor);
  const Accepted accepted = accept(market_, {{"acme", keeper().keys.get("acme").open()}}, keeper());
  ASSERT_EQ(accepted.unknown.size(), 1U);
  EXPECT_TRUE(accepted.unknown[0].other_key);
  EXPECT_EQ(market_roles(market_, keeper()).back().keys.keys, std::vector{acme().key});
}

TEST_F(MarketplaceAttack, PackageHandedInUnderTheNameOfAnother) {
  const tuf::SigningKey key = options("globex", 0).keys.make("globex");
  const tuf::TargetInfo taken{"acme/nav-1.0.0-any.fpk", 1, {{"sha256", std::string(64, 'a')}}, ""};
  write_file(market_ / "incoming/globex.json", tuf::next_role(std::nullopt, key, {taken}, true, day(100)));
  EXPECT_THAT(texts(accept(market_, {{"globex", key.open()}}, keeper()).refused),
              ElementsAre(HasSubstr("it signs for acme/nav-1.0.0-any.fpk, and may for globex/… only")));
}

// ---- the keeper ----

TEST_F(MarketplaceAttack, PublishersFileThatHoldsUpTheOthers) {
  const KeeperOptions other = options("globex", 0);
  const tuf::SigningKey key = other.keys.make("globex");
  auto role = tuf::role_in(tuf::next_role(std::nullopt, key, {}, true, day(100)));
  role["targets"]["globex/map-1.0.0-any.fpk"] = {{"length", 1}, {"hashes", {{"sha512", std::string(128, 'a')}}}};
  write_file(market_ / "incoming/globex.json", tuf::signed_role_file(role, {key}));
  const auto file = packed("nav", "1.1.0");
  sign_package(file, author());
  submit(file, market_, author());
  const Accepted accepted = accept(market_, {{"globex", key.open()}}, keeper());
  EXPECT_THAT(accepted.packages, ElementsAre(HasSubstr("acme/nav-1.1.0")));
  EXPECT_THAT(texts(accepted.refused),
              ElementsAre(HasSubstr("globex.json signs for globex/map-1.0.0-any.fpk without its sha256")));
}

TEST_F(MarketplaceAttack, VersionThatNobodyCouldFollow) {
  constexpr std::int64_t kLast = std::numeric_limits<std::int64_t>::max();
  const tuf::SigningKey key = author().keys.get("acme");
  const std::string role = tuf::next_role(author().keys.signed_role("acme"), key, {}, false, day(100), kLast);
  write_file(market_ / "incoming/acme.json", role);
  EXPECT_THAT(texts(accept(market_, {}, keeper()).refused),
              ElementsAre(HasSubstr("version 1 is here: nobody has signed so often")));
  EXPECT_THAT(error_of([&] { tuf::next_role(role, key, {}, false, day(100)); }).what(),
              HasSubstr("it is the last that there is"));
}

TEST_F(MarketplaceAttack, RootProposedByWhoCanWriteIntoTheDirectory) {
  const auto before = root_keys();
  const auto mallory = options("mallory", 0);
  mallory.keys.make("mallory");
  tuf::Client::trust(mallory.keys.path() / "kept" / tuf::percent_encoded(market_.string()), root_);
  EXPECT_EQ(rotate(market_, "root", {"mallory"}, 1, mallory).lacking, 1);  // the old root's signature
  const auto seen = market_roles(market_, keeper());
  ASSERT_TRUE(seen[0].proposed);
  accept(market_, {}, keeper());
  EXPECT_EQ(root_keys(), before);
  rotate(market_, "online", {}, 1, keeper());  // takes its place
  EXPECT_EQ(root_keys(), before);
}

// ---- the store ----

TEST_F(MarketplaceAttack, LibraryChangedInTheStore) {
  ASSERT_EQ(install_fault("steps"), "");
  const auto library = store().find("steps").library;
  std::string bytes = testing::file_content(library);
  bytes.back() ^= 1;
  testing::write_file(library, bytes);
  EXPECT_THAT(verify_fault("steps"), HasSubstr("has other content"));
}

TEST_F(MarketplaceAttack, LibraryInTheStoreReplacedByALink) {
  ASSERT_EQ(install_fault("steps"), "");
  const auto library = store().find("steps").library;
  std::filesystem::copy_file(library, scratch_ / "evil.so");
  std::filesystem::remove(library);
  std::filesystem::create_symlink(scratch_ / "evil.so", library);
  EXPECT_THAT(verify_fault("steps"), HasSubstr("cannot be read"));
}

TEST_F(MarketplaceAttack, FileAddedToAPackageInTheStore) {
  ASSERT_EQ(install_fault("steps"), "");
  testing::write_file(store().find("steps").directory / "lib/libc.so.6", "evil");
  EXPECT_THAT(verify_fault("steps"), HasSubstr("lib/libc.so.6 does not belong to it"));
}

TEST_F(MarketplaceAttack, RightsAddedToAManifestInTheStore) {
  ASSERT_EQ(install_fault("steps"), "");
  const auto manifest = store().find("steps").directory / "manifest.textproto";
  testing::write_file(manifest, testing::file_content(manifest) + "rights: 'network'\n");
  EXPECT_THAT(verify_fault("steps"), HasSubstr("its manifest is not the one that was installed"));
}

}  // namespace
}  // namespace fiona::marketplace
