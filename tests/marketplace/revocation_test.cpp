// What a keeper has revoked: nobody installs it any more, and who has it is told and cannot start it.
#include <gmock/gmock.h>

#include <fiona/marketplace/store.hpp>

#include "kept_market.hpp"

namespace fiona::marketplace {
namespace {

using testing::error_of;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class RevokedPackage : public KeptMarket {
 protected:
  void SetUp() override {
    KeptMarket::SetUp();
    hand_in(packed("steps", "1.0.0"));
    hand_in(packed("other", "1.0.0"));
  }

  Store store() const { return Store{scratch_ / "store"}; }
  std::vector<Revocation> refresh(int on_day = 0) {
    return note_revocations(open_marketplace(market_.string(), user(on_day)), scratch_ / "store");
  }
  std::string start_fault(const std::string& name) const {
    try {
      store().require_not_revoked(store().find(name));
      return {};
    } catch (const Error& error) {
      return error.what();
    }
  }
};

TEST_F(RevokedPackage, IsNotStartedAnyMoreAfterOneRefreshAndSaysWhy) {
  ASSERT_EQ(install_fault("steps"), "");
  ASSERT_EQ(install_fault("other"), "");
  EXPECT_THAT(revoke(market_, "acme/steps@1.0.0", "it counts backwards", keeper()), SizeIs(1));
  EXPECT_EQ(start_fault("steps"), "");  // nobody has asked yet
  const auto news = refresh();
  ASSERT_THAT(news, SizeIs(1));
  EXPECT_EQ(news[0].package(), "acme/steps");
  EXPECT_THAT(start_fault("steps"), HasSubstr("acme/steps 1.0.0 has been revoked: it counts backwards"));
  EXPECT_THAT(start_fault("steps"), HasSubstr("market update acme/steps, or market remove acme/steps"));
  EXPECT_EQ(start_fault("other"), "");
}

TEST_F(RevokedPackage, IsToldOnceAndStaysRevoked) {
  ASSERT_EQ(install_fault("steps"), "");
  revoke(market_, "acme/steps", "", keeper());
  EXPECT_THAT(refresh(), SizeIs(1));
  EXPECT_THAT(refresh(), IsEmpty());
  std::filesystem::remove_all(scratch_ / "user/copies");  // what was fetched has no say in it
  EXPECT_THAT(start_fault("steps"), HasSubstr("has been revoked: no reason is given"));
}

TEST_F(RevokedPackage, AClockSetBackRevivesNothing) {
  ASSERT_EQ(install_fault("steps", 10), "");
  revoke(market_, "acme/steps", "", keeper(10));
  EXPECT_THAT(refresh(10), SizeIs(1));
  EXPECT_THAT(refresh(0), IsEmpty());
  EXPECT_THAT(start_fault("steps"), HasSubstr("has been revoked"));
  EXPECT_THAT(install_fault("steps", 0), HasSubstr("the marketplace has no package steps"));
}

TEST_F(RevokedPackage, CannotBeInstalled) {
  revoke(market_, "acme/steps", "", keeper());
  EXPECT_THAT(install_fault("steps"), HasSubstr("the marketplace has no package steps"));
  EXPECT_EQ(install_fault("other"), "");
}

TEST_F(RevokedPackage, AnUpdateTakesItsPlaceAndStarts) {
  ASSERT_EQ(install_fault("steps"), "");
  revoke(market_, "acme/steps@1.0.0", "", keeper());
  refresh();
  hand_in(packed("steps", "1.0.1"));
  ASSERT_EQ(install_fault("steps"), "");
  EXPECT_EQ(start_fault("steps"), "");
  EXPECT_EQ(store().find("steps").manifest.version(), "1.0.1");
}

TEST_F(RevokedPackage, GoingBackDoesNotReviveIt) {
  ASSERT_EQ(install_fault("steps"), "");
  hand_in(packed("steps", "1.0.1"));
  ASSERT_EQ(install_fault("steps"), "");
  revoke(market_, "acme/steps@1.0.0", "", keeper());
  refresh();
  EXPECT_EQ(start_fault("steps"), "");
  apply(plan_rollback(std::nullopt, store()), {}, scratch_ / "store");
  EXPECT_EQ(store().find("steps").manifest.version(), "1.0.0");
  EXPECT_THAT(start_fault("steps"), HasSubstr("has been revoked"));
}

TEST_F(RevokedPackage, APublisherWhoseKeyIsRevokedSignsForNothingAnyMore) {
  ASSERT_EQ(install_fault("steps"), "");
  EXPECT_THAT(revoke(market_, "acme", "the key was stolen", keeper()), SizeIs(2));
  EXPECT_THAT(refresh(), SizeIs(1));
  EXPECT_THAT(start_fault("steps"), HasSubstr("the key was stolen"));
  const auto evil = packed("steps", "2.0.0");
  sign_package(evil, author());
  submit(evil, market_, author());
  const Accepted accepted = accept(market_, {}, keeper());
  EXPECT_THAT(accepted.packages, IsEmpty());
  EXPECT_THAT(accepted.unknown, SizeIs(1));
  EXPECT_THAT(install_fault("steps"), HasSubstr("no package steps"));
}

TEST_F(RevokedPackage, APublisherComesBackWithAnotherKeyWhichIsShownAsNew) {
  ASSERT_EQ(install_fault("steps"), "");
  revoke(market_, "acme", "the key was stolen", keeper());
  const tuf::OpenKey key = renew_key("acme", author());
  const Accepted accepted = hand_in(packed("steps", "2.0.0"));
  EXPECT_THAT(accepted.refused, IsEmpty());
  ASSERT_THAT(accepted.packages, SizeIs(1));
  const Marketplace market = open_marketplace(market_.string(), user());
  const Plan plan = plan_install({"steps"}, market, store());
  ASSERT_THAT(plan.steps, SizeIs(1));
  EXPECT_FALSE(plan.steps[0].new_publisher);
  EXPECT_THAT(plan.steps[0].new_keys, ::testing::ElementsAre(key));
  EXPECT_THAT(plan.steps[0].known_keys, SizeIs(1));
  EXPECT_TRUE(plan.needs_consent());
}

TEST_F(RevokedPackage, ADamagedListOfThemStartsNothing) {
  ASSERT_EQ(install_fault("steps"), "");
  testing::write_file(scratch_ / "store/revoked.textproto", "packages { blake2b: ");
  EXPECT_THAT(start_fault("steps"), HasSubstr("the list of revoked packages is damaged"));
}

TEST_F(RevokedPackage, WhatIsNotOfferedIsNamedWithWhatIs) {
  const Error error = error_of([&] { revoke(market_, "acme/step", "", keeper()); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_THAT(error.text().near, ::testing::Contains("acme/steps"));
}

TEST_F(RevokedPackage, NobodyElseRevokes) {
  const Error error = error_of([&] { revoke(market_, "acme/steps", "", author()); });
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
}

TEST_F(RevokedPackage, AReasonCannotDriveATerminal) {
  const Error error = error_of([&] { revoke(market_, "acme/steps", "\x1b[2J", keeper()); });
  EXPECT_THAT(error.text().what, HasSubstr("the reason"));
}

/// The publisher signs for steps no longer.
class WithdrawnPackage : public RevokedPackage {
 protected:
  void SetUp() override {
    RevokedPackage::SetUp();
    ASSERT_EQ(install_fault("steps"), "");
    std::filesystem::remove(author().keys.path() / "acme.json");
    for (int i = 0; i < 3; ++i) hand_in(packed("other", "1." + std::to_string(i) + ".0"));  // version 3 again
    ASSERT_EQ(target("steps-1.0.0-x86_64.fpk"), "");
  }
};

TEST_F(WithdrawnPackage, IsRevokedForWhoHasIt) {
  EXPECT_THAT(revoke(market_, "acme/steps@1.0.0", "it counts backwards", keeper()), SizeIs(1));
  EXPECT_THAT(refresh(), SizeIs(1));
  EXPECT_THAT(start_fault("steps"), HasSubstr("has been revoked: it counts backwards"));
}

TEST_F(WithdrawnPackage, GoesWithAllOfItsPublisher) {
  EXPECT_THAT(revoke(market_, "acme", "the key was stolen", keeper()), SizeIs(4));
  EXPECT_THAT(refresh(), SizeIs(1));
}

TEST_F(WithdrawnPackage, ComesBackToTheByteAndNotOtherwise) {
  EXPECT_THAT(texts(hand_in(packed("steps", "1.0.0", "other code")).refused),
              ::testing::ElementsAre(HasSubstr("acme/steps 1.0.0 was published and withdrawn, with other content")));
  EXPECT_THAT(hand_in(packed("steps", "1.0.0")).packages, SizeIs(1));
  EXPECT_THAT(revoke(market_, "acme/steps", "", keeper()), SizeIs(1)) << "it is listed once";
}

// ---- whom a name stands for ----

TEST_F(KeptMarket, TheKeyOfANewPublisherIsShown) {
  hand_in(packed("steps", "1.0.0"));
  const Plan plan = plan_install({"steps"}, open_marketplace(market_.string(), user()), Store{scratch_ / "store"});
  EXPECT_TRUE(plan.steps[0].new_publisher);
  EXPECT_THAT(plan.steps[0].new_keys, ::testing::ElementsAre(author().keys.get("acme").open()));
}

TEST_F(KeptMarket, AKnownPublisherWithTheSameKeyIsNotAskedAboutAgain) {
  hand_in(packed("steps", "1.0.0"));
  ASSERT_EQ(install_fault("steps"), "");
  hand_in(packed("other", "1.0.0"));
  const Plan plan = plan_install({"other"}, open_marketplace(market_.string(), user()), Store{scratch_ / "store"});
  EXPECT_FALSE(plan.steps[0].new_publisher);
  EXPECT_THAT(plan.steps[0].new_keys, IsEmpty());
  EXPECT_FALSE(plan.needs_consent());
}

}  // namespace
}  // namespace fiona::marketplace
