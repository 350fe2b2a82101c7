// Other keys for a marketplace and its publishers: users follow by themselves, and the former keys are good for
// nothing.
#include <gmock/gmock.h>

#include <fstream>

#include "kept_market.hpp"

namespace fiona::marketplace {
namespace {

using testing::error_of;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class Rotation : public KeptMarket {
 protected:
  void SetUp() override {
    KeptMarket::SetUp();
    hand_in(packed("steps", "1.0.0"));
    ASSERT_EQ(install_fault("steps"), "");
  }

  // A user who was there before the change, and one who has trusted the first root only now.
  void expect_all_follow() {
    hand_in(packed("steps", next_version()));
    EXPECT_EQ(install_fault("steps"), "");
    OpenOptions late = user();
    late.trusted = scratch_ / "late/trusted";
    late.copies = scratch_ / "late/copies";
    trust_marketplace(root_, market_.string(), late);
    EXPECT_NO_THROW(install("steps", open_marketplace(market_.string(), late), scratch_ / "late/store"));
    std::filesystem::remove_all(scratch_ / "late");
  }
  // As each holder of a key does once, with `keys trust`.
  void trust_as_user(const std::string& root) {
    tuf::Client::trust(scratch_ / "markets" / tuf::percent_encoded(market_.string()), root);
  }
  std::filesystem::path published(int version) const {
    return market_ / "metadata" / (std::to_string(version) + ".acme.json");
  }
  Accepted submit_again(const std::string& name) {
    submit(scratch_ / ("out/" + name + ".fpk"), market_, author());
    return accept(market_, {acme()}, keeper());
  }
  std::string next_version() { return "1.0." + std::to_string(++patch_); }
  void forget_key(const std::string& name) { std::filesystem::remove(keeper().keys.path() / (name + ".key")); }
  tuf::Repository::RoleKeys keys_of(const std::string& role) const {
    for (const auto& one : market_roles(market_, keeper())) {
      if (one.name == role) return one.keys;
    }
    return {};
  }

  int patch_ = 0;
};

TEST_F(Rotation, ANewKeyIsCalledLikeThoseOfItsMarketplace) {
  const auto other = scratch_ / "elsewhere" / market_.filename();
  init_market(other, keeper());
  const std::string base = market_.filename().string();
  EXPECT_EQ(rotate(other, "online", {}, 1, keeper()).made, std::vector<std::string>{base + "-2.online-2"});
  EXPECT_EQ(rotate(other, "online", {}, 1, keeper()).made, std::vector<std::string>{base + "-2.online-3"});
  EXPECT_EQ(rotate(market_, "online", {}, 1, keeper()).made, std::vector<std::string>{base + ".online-2"});
}

TEST_F(Rotation, AKeyOfSomethingElseThatCannotBeReadIsInNobodysWay) {
  std::ofstream(keeper().keys.path() / "aaa.online.key") << "no key";
  EXPECT_EQ(rotate(market_, "online", {}, 1, keeper()).lacking, 0);
}

TEST_F(Rotation, TheOnlineKeyIsReplacedAndTheFormerOneSignsNothing) {
  const auto before = keys_of("online").keys;
  const RootChange change = rotate(market_, "online", {}, 1, keeper());
  EXPECT_EQ(change.lacking, 0);
  EXPECT_THAT(change.made, ::testing::ElementsAre("market.online-2"));
  EXPECT_NE(keys_of("online").keys, before);
  forget_key("market.online");
  expect_all_follow();
  forget_key("market.online-2");
  EXPECT_EQ(error_of([&] { accept(market_, {}, keeper()); }).code(), ErrorCode::NotAllowed);
}

TEST_F(Rotation, TheKeyOfTheTargetsIsReplaced) {
  rotate(market_, "targets", {}, 1, keeper());
  forget_key("market.targets");
  expect_all_follow();
}

TEST_F(Rotation, TheKeyOfTheRootIsReplacedAgainAndAgain) {
  rotate(market_, "root", {}, 1, keeper());
  forget_key("market.root");
  rotate(market_, "root", {}, 1, keeper());
  rotate(market_, "online", {}, 1, keeper());
  expect_all_follow();
}

TEST_F(Rotation, TwoOfThreeRootKeysAreEnoughAndOneIsNot) {
  for (const auto* name : {"alice", "bob", "carol"}) options(name, 0).keys.make(name);
  const auto open = [&](const std::string& name) { return options(name, 0).keys.get(name).open(); };
  const RootChange first = rotate(market_, "root", {open("alice"), open("bob"), open("carol")}, 2, keeper());
  EXPECT_EQ(first.lacking, 2);  // the old root's has signed, none of the new ones
  EXPECT_EQ(keys_of("root").threshold, 1);
  trust_as_user(root_);
  const auto signed_by = [&](const std::string& name) {
    const auto seen = market_roles(market_, options(name, 0));
    return sign_root(market_, seen, options(name, 0)).lacking;
  };
  EXPECT_EQ(signed_by("alice"), 1);
  EXPECT_EQ(signed_by("bob"), 0);
  accept(market_, {}, keeper());  // who has the online keys makes it the root
  EXPECT_EQ(keys_of("root").threshold, 2);
  EXPECT_THAT(keys_of("root").keys, SizeIs(3));
  expect_all_follow();
  // The former root key alone changes nothing any more; nor does one of the new ones.
  EXPECT_EQ(rotate(market_, "online", {}, 1, keeper()).lacking, 4);
  EXPECT_EQ(signed_by("carol"), 2);
  EXPECT_EQ(signed_by("alice"), 0);
  accept(market_, {}, keeper());
  expect_all_follow();
}

TEST_F(Rotation, AThresholdThatCannotBeMetIsRefused) {
  EXPECT_EQ(error_of([&] { rotate(market_, "root", {"market.root"}, 2, keeper()); }).code(), ErrorCode::Usage);
  EXPECT_EQ(error_of([&] {
              rotate(market_, "root", {"market.root", "market.root"}, 2, keeper());
            }).code(),
            ErrorCode::Usage);
  EXPECT_EQ(error_of([&] { rotate(market_, "online", {}, 2, keeper()); }).code(), ErrorCode::Usage);
  EXPECT_EQ(error_of([&] { rotate(market_, "nonsense", {}, 1, keeper()); }).code(), ErrorCode::Usage);
}

TEST_F(Rotation, AProposalOtherThanTheOneThatWasLookedAtIsNotSigned) {
  for (const auto* name : {"alice", "mallory"}) options(name, 0).keys.make(name);
  const auto open = [&](const std::string& name) { return options(name, 0).keys.get(name).open(); };
  rotate(market_, "root", {open("alice")}, 1, keeper());
  const auto seen = market_roles(market_, keeper());
  rotate(market_, "root", {open("mallory")}, 1, keeper());
  EXPECT_EQ(error_of([&] { sign_root(market_, seen, keeper()); }).text().what,
            "another root has been proposed meanwhile");
}

TEST_F(Rotation, AProposalThatIsNoneIsRefused) {
  testing::write_file(market_ / "root.proposed.json", "{}");
  EXPECT_EQ(error_of([&] { market_roles(market_, keeper()); }).code(), ErrorCode::BadSignature);
  EXPECT_EQ(error_of([&] { sign_root(market_, {}, keeper()); }).code(), ErrorCode::BadSignature);
}

TEST_F(Rotation, APublishersKeyIsRenewedAndKeepsWhatWasSigned) {
  const tuf::OpenKey before = author().keys.get("acme").open();
  const tuf::OpenKey key = renew_key("acme", author());
  EXPECT_NE(key, before);
  hand_in(packed("steps", "2.0.0"));
  EXPECT_EQ(install_fault("steps@1.0.0"), "");
  EXPECT_EQ(install_fault("steps@2.0.0"), "");
  EXPECT_THAT(keys_of("acme").keys, ::testing::ElementsAre(key));
}

TEST_F(Rotation, APublisherWhoHasLostWhatHeSignedGoesOnAfterWhatIsPublished) {
  hand_in(packed("steps", "1.1.0"));
  std::filesystem::remove(author().keys.path() / "acme.json");
  const Accepted refused = hand_in(packed("steps", "1.2.0"));
  EXPECT_THAT(texts(refused.refused),
              ::testing::ElementsAre(AllOf(HasSubstr("it is version 1, and version 2 is here already"),
                                           HasSubstr("fiona plugin sign FILE after=" + published(2).string()))));
  sign_package(packed("steps", "1.2.0"), author(), published(2));
  EXPECT_THAT(submit_again("steps-1.2.0").packages, ::testing::SizeIs(1));
  EXPECT_EQ(install_fault("steps@1.1.0"), "");
  EXPECT_EQ(install_fault("steps@1.2.0"), "");
}

TEST_F(Rotation, APublisherWhoSignsAgainWhatIsThereInTheSameVersionIsNotIgnored) {
  std::filesystem::remove(author().keys.path() / "acme.json");
  EXPECT_THAT(texts(hand_in(packed("steps", "1.2.0")).refused),
              ::testing::ElementsAre(HasSubstr("it is version 1, and version 1 is here already")));
}

/// A publisher whose key is lost has made another.
class LostKey : public Rotation {
 protected:
  void SetUp() override {
    Rotation::SetUp();
    hand_in(packed("steps", "1.1.0"));
    before = author().keys.get("acme").open();
    std::filesystem::remove_all(author().keys.path());
    author().keys.make("acme");
  }
  tuf::OpenKey before;
};

TEST_F(LostKey, WhoseFileIsRefusedIsNotTrustedYetAndWhatIsPublishedStays) {
  EXPECT_THAT(texts(hand_in(packed("steps", "1.2.0")).refused),
              ::testing::ElementsAre(HasSubstr("it is version 1, and version 2 is here already")));
  EXPECT_THAT(keys_of("acme").keys, ::testing::ElementsAre(before));
  EXPECT_EQ(install_fault("steps@1.1.0"), "");
}

TEST_F(LostKey, SignsWithTheOtherAfterWhatIsPublishedAndForNothingThatItHasNotSeen) {
  sign_package(packed("steps", "1.2.0"), author(), published(2));
  EXPECT_THAT(submit_again("steps-1.2.0").packages, ::testing::SizeIs(1));
  EXPECT_THAT(keys_of("acme").keys, ::testing::ElementsAre(author().keys.get("acme").open()));
  EXPECT_EQ(install_fault("steps@1.2.0"), "");
  EXPECT_THAT(install_fault("steps@1.1.0"), HasSubstr("no such version"));
}

TEST_F(LostKey, SignsAfterAFileOfAPublisherOnly) {
  EXPECT_EQ(error_of([&] { sign_package(packed("steps", "1.2.0"), author(), scratch_ / "none"); }).code(),
            ErrorCode::NotFound);
  EXPECT_EQ(error_of([&] { sign_package(packed("steps", "1.2.0"), author(), market_ / "metadata/2.targets.json"); })
                .text()
                .what,
            "this is not what a publisher has signed");
}

TEST_F(LostKey, WhoHandsInNothingOfWhatHeSignsForIsNotTrustedYet) {
  sign_package(packed("steps", "1.2.0"), author(), published(2));
  submit(scratch_ / "out/steps-1.2.0.fpk", market_, author());
  for (const auto& entry : std::filesystem::directory_iterator(market_ / "incoming")) {
    if (entry.path().extension() == ".fpk") std::filesystem::remove(entry.path());
  }
  EXPECT_THAT(texts(accept(market_, {acme()}, keeper()).refused),
              ::testing::ElementsAre(HasSubstr("has not come with it")));
  EXPECT_THAT(keys_of("acme").keys, ::testing::ElementsAre(before));
  EXPECT_EQ(install_fault("steps@1.1.0"), "");
}

}  // namespace
}  // namespace fiona::marketplace
