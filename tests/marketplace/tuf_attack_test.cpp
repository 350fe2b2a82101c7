// Attacks on the supply chain, each by its name, each refused for the right reason.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fiona/error.hpp>

#include "tuf_simulator.hpp"

namespace fiona::tuf::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class SupplyChainAttack : public ::testing::Test, protected TufTest {
 protected:
  // A client that has seen two versions of everything and one delegated role with a target.
  void SetUp() override {
    sim.delegate("targets", "acme", {"acme/*"});
    sim.add_target("acme", "acme/steps", "good content");
    sim.publish_targets();
    ASSERT_EQ(download("acme/steps"), "");
    for (const auto& role : {"root", "timestamp", "snapshot", "targets", "acme"}) before_[role] = trusted_version(role);
  }

  // Whatever was tried: what was trusted is still there, and never of an older version. A root that is properly signed
  // and changes keys makes forget what the old ones signed.
  void TearDown() override {
    const bool new_keys = trusted_version("root") > 1;
    for (const auto& [role, version] : before_) {
      if (new_keys && (role == "timestamp" || role == "snapshot")) continue;
      EXPECT_GE(trusted_version(role), version) << role;
    }
  }

  std::string attacked_download() {
    std::filesystem::remove_all(downloads);
    const std::string refused = download("acme/steps");
    EXPECT_FALSE(std::filesystem::exists(downloads / "acme%2Fsteps"));
    return refused;
  }

  std::string served_target() const { return "acme/" + sha256_text("good content") + ".steps"; }

  Simulator& sim = *repository;
  std::map<std::string, int> before_;  // version by role
};

// ---- arbitrary software ----

TEST_F(SupplyChainAttack, TamperedTarget) {
  sim.served[served_target()] = "evil content";
  EXPECT_THAT(attacked_download(), HasSubstr("acme/steps is not the one that was signed for: it has another sha256"));
}

TEST_F(SupplyChainAttack, TruncatedTarget) {
  sim.served[served_target()] = "good";
  EXPECT_THAT(attacked_download(), HasSubstr("acme/steps is not the one that was signed for: it has another length"));
}

TEST_F(SupplyChainAttack, EndlessTarget) {
  sim.served[served_target()] = "good content" + std::string(1 << 20, 'x');
  EXPECT_THAT(attacked_download(), HasSubstr("endless data"));
}

TEST_F(SupplyChainAttack, AnotherTargetUnderItsName) {
  sim.add_target("acme", "acme/other", "good contenT");
  sim.publish_targets("acme");
  sim.served[served_target()] = "good contenT";
  EXPECT_THAT(attacked_download(), HasSubstr("it has another sha256"));
}

TEST_F(SupplyChainAttack, TargetThatWasOnlyPutThere) {
  sim.target_files["acme/extra"] = "evil";
  EXPECT_THAT(download("acme/extra"), HasSubstr("nobody who may has signed for a target acme/extra"));
}

TEST_F(SupplyChainAttack, TamperedFileInTheDownloadDirectory) {
  marketplace::testing::write_file(downloads / "acme%2Fsteps", "evil content");
  EXPECT_EQ(download("acme/steps"), "");
  EXPECT_EQ(marketplace::testing::file_content(downloads / "acme%2Fsteps"), "good content");
}

TEST_F(SupplyChainAttack, LinkInTheDownloadDirectory) {
  const auto victim = directory / "victim";
  marketplace::testing::write_file(victim, "precious");
  std::filesystem::remove(downloads / "acme%2Fsteps");
  std::filesystem::create_symlink(victim, downloads / "acme%2Fsteps");
  EXPECT_EQ(download("acme/steps"), "");
  EXPECT_EQ(marketplace::testing::file_content(victim), "precious");
}

TEST_F(SupplyChainAttack, TargetThatLeadsOutOfTheDownloadDirectory) {
  sim.add_target("targets", "../../escaped", "evil");
  sim.publish_targets();
  EXPECT_EQ(download("../../escaped"), "");
  EXPECT_TRUE(std::filesystem::exists(downloads / "..%2F..%2Fescaped"));
  EXPECT_FALSE(std::filesystem::exists(directory / "escaped"));
}

// ---- publishers ----

TEST_F(SupplyChainAttack, PublisherSpeaksForAnother) {
  sim.delegate("targets", "mallory", {"mallory/*"});
  sim.publish_targets();
  sim.add_target("mallory", "acme/new", "evil");
  sim.publish_targets("mallory");
  EXPECT_THAT(download("acme/new"), HasSubstr("nobody who may has signed for a target acme/new"));
}

TEST_F(SupplyChainAttack, PublisherOverridesAnother) {
  Json& acme = sim.targets["targets"]["delegations"]["roles"];
  sim.delegate("targets", "mallory", {"mallory/*"});
  std::swap(acme[0], acme[1]);  // even where it is asked first
  sim.add_target("mallory", "acme/steps", "evil content");
  sim.target_files["acme/steps"] = "good content";
  sim.publish_targets();
  EXPECT_EQ(download("acme/steps"), "");
  EXPECT_EQ(marketplace::testing::file_content(downloads / "acme%2Fsteps"), "good content");
}

TEST_F(SupplyChainAttack, PublisherDelegatesMoreThanItHas) {
  sim.delegate("acme", "friend", {"*"});
  sim.publish_targets("acme");
  sim.add_target("friend", "other/x", "evil");
  sim.publish_targets("friend");
  EXPECT_THAT(download("other/x"), HasSubstr("nobody who may has signed for a target other/x"));
}

TEST_F(SupplyChainAttack, PrefixOfAPublishersName) {
  sim.add_target("acme", "acme-evil/x", "evil");
  sim.publish_targets("acme");
  EXPECT_THAT(download("acme-evil/x"), HasSubstr("nobody who may"));
}

TEST_F(SupplyChainAttack, PatternDoesNotReachIntoDirectories) {
  sim.add_target("acme", "acme/deep/x", "evil");
  sim.publish_targets("acme");
  EXPECT_THAT(download("acme/deep/x"), HasSubstr("nobody who may"));
}

TEST_F(SupplyChainAttack, LookAlikeName) {
  const std::string cyrillic = "\u0430cme/steps";  // U+0430
  EXPECT_THAT(download(cyrillic), HasSubstr("nobody who may"));
}

TEST_F(SupplyChainAttack, NameOfAnotherCase) { EXPECT_THAT(download("Acme/steps"), HasSubstr("nobody who may")); }

TEST_F(SupplyChainAttack, PublishersFileSignedByAnotherPublisher) {
  sim.delegate("targets", "mallory", {"mallory/*"});
  sim.publish_targets();
  sim.signers["acme"] = sim.signers["mallory"];
  sim.publish_targets("acme");
  EXPECT_THAT(attacked_download(), HasSubstr("acme.json is not signed by the role 'acme'"));
}

TEST_F(SupplyChainAttack, RevokedPublisher) {
  sim.targets["targets"].erase("delegations");
  sim.publish_targets();
  EXPECT_THAT(attacked_download(), HasSubstr("nobody who may has signed for a target acme/steps"));
}

TEST_F(SupplyChainAttack, DelegationThatTakesATopLevelName) {
  sim.targets["targets"]["delegations"]["roles"][0]["name"] = "root";
  sim.publish_targets();
  EXPECT_THAT(refresh(), HasSubstr("it delegates to a role named 'root', which no delegated role may be"));
}

TEST_F(SupplyChainAttack, DelegationCycle) {
  sim.delegate("acme", "friend", {"acme/*"});
  sim.delegate("friend", "acme", {"acme/*"});
  sim.publish_targets("acme");
  EXPECT_THAT(download("acme/absent"), HasSubstr("nobody who may"));
}

TEST_F(SupplyChainAttack, EndlessDelegations) {
  std::string from = "acme";
  for (int i = 0; i < 60; ++i) {
    sim.delegate(from, "r" + std::to_string(i), {"acme/*"});
    from = "r" + std::to_string(i);
  }
  sim.add_target(from, "acme/deep", "content");
  sim.publish_targets("acme");
  sim.requests.clear();
  EXPECT_THAT(download("acme/deep"), HasSubstr("nobody who may"));
  EXPECT_LE(sim.requests.size(), 36U);
}

TEST_F(SupplyChainAttack, SameRoleDelegatedTwice) {
  Json& roles = sim.targets["targets"]["delegations"]["roles"];
  roles.push_back(roles[0]);
  sim.publish_targets();
  EXPECT_THAT(refresh(), HasSubstr("it delegates to the role 'acme' twice"));
}

TEST_F(SupplyChainAttack, RoleOfOnePublisherUsedUnderTheKeysOfAnother) {
  // "shared" is acme's, with acme's key for it; mallory names the same role with a key of his own.
  sim.delegate("acme", "shared", {"acme/*"});
  sim.delegate("targets", "mallory", {"mallory/*"});
  const TestKey evil = ed25519_key();
  sim.targets["mallory"]["delegations"] = {{"keys", {{evil.id, evil.open}}},
                                           {"roles",
                                            {{{"name", "shared"},
                                              {"keyids", {evil.id}},
                                              {"threshold", 1},
                                              {"paths", {"mallory/*"}},
                                              {"terminating", false}}}}};
  sim.publish_targets();
  sim.add_target("shared", "acme/shared", "good");
  sim.publish_targets("shared");
  Client client{options()};
  client.refresh();
  EXPECT_EQ(client.target("acme/shared").length, 4U);
  try {
    client.target("mallory/x");
    FAIL() << "it was accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("shared.json is not signed by the role 'shared'"));
  }
}

// ---- signatures and keys ----

TEST_F(SupplyChainAttack, UnsignedRole) {
  sim.signers["timestamp"].clear();
  sim.publish_timestamp();
  EXPECT_THAT(refresh(),
              AllOf(HasSubstr("timestamp.json is not signed by the role 'timestamp'"), HasSubstr("found: 0")));
}

TEST_F(SupplyChainAttack, SignedByAStranger) {
  sim.signers["snapshot"] = {ed25519_key()};
  sim.publish_snapshot();
  EXPECT_THAT(refresh(), HasSubstr("snapshot.json is not signed by the role 'snapshot'"));
}

TEST_F(SupplyChainAttack, KeyOfAnotherRole) {
  sim.signers["targets"] = sim.signers["timestamp"];
  sim.publish_targets();
  EXPECT_THAT(refresh(), HasSubstr("targets.json is not signed by the role 'targets'"));
}

TEST_F(SupplyChainAttack, ThresholdByOneKeySigningTwice) {
  const TestKey one = ed25519_key(), two = ed25519_key();
  sim.set_keys("timestamp", {one, two}, 2);
  sim.publish_root();
  sim.signers["timestamp"] = {one, one};
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("has two signatures"));
}

TEST_F(SupplyChainAttack, ThresholdByOneKeyUnderTwoIds) {
  const TestKey one = ed25519_key();
  TestKey again = one;
  again.id = "0123456789";
  sim.set_keys("timestamp", {one, again}, 2);
  sim.publish_root();
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), AllOf(HasSubstr("timestamp.json is not signed"), HasSubstr("found: 1")));
}

TEST_F(SupplyChainAttack, ThresholdByOneRsaKeyUnderTwoSchemes) {
  const TestKey pss = rsa_key("rsassa-pss-sha256");
  TestKey again = pss;
  again.open["x-note"] = "another";
  again.id = "0123456789";
  sim.list_hashes = false;
  sim.set_keys("timestamp", {pss, again}, 2);
  sim.publish_root();
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("found: 1"));
}

TEST_F(SupplyChainAttack, ThresholdNotMet) {
  const TestKey one = ed25519_key(), two = ed25519_key();
  sim.set_keys("snapshot", {one, two}, 2);
  sim.publish_root();
  sim.signers["snapshot"] = {one};
  sim.publish_snapshot();
  EXPECT_THAT(refresh(), HasSubstr("valid signatures of 2 different keys out of its 2"));
}

TEST_F(SupplyChainAttack, ThresholdOfZero) {
  sim.root["roles"]["timestamp"]["threshold"] = 0;
  sim.publish_root();
  EXPECT_THAT(refresh(), HasSubstr("'threshold' is not an integer from 1 on"));
}

TEST_F(SupplyChainAttack, KeyOfAnUnknownKindCountsForNothing) {
  TestKey strange = ed25519_key();
  strange.open["keytype"] = "trust-me";
  sim.set_keys("timestamp", {strange});
  sim.publish_root();
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("found: 0"));
}

TEST_F(SupplyChainAttack, KeyOfTheWrongSchemeCountsForNothing) {
  TestKey strange = ed25519_key();
  strange.open["scheme"] = "rsassa-pss-sha256";
  sim.set_keys("timestamp", {strange});
  sim.publish_root();
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("found: 0"));
}

TEST_F(SupplyChainAttack, RsaKeyThatIsTooShort) {
  sim.list_hashes = false;
  sim.set_keys("timestamp", {rsa_key("rsa-pkcs1v15-sha256", 1024)});
  sim.publish_root();
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("found: 0"));
}

TEST_F(SupplyChainAttack, EcdsaKeyOnAnotherCurve) {
  sim.list_hashes = false;
  sim.set_keys("timestamp", {ecdsa_key("ecdsa", "P-384")});
  sim.publish_root();
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("found: 0"));
}

TEST_F(SupplyChainAttack, KeySwapInARootOfItsOwn) {
  sim.set_keys("root", {ed25519_key()});
  sim.publish_root();  // signed by the new key alone
  EXPECT_THAT(refresh(), HasSubstr("2.root.json is not signed by the root before it"));
  EXPECT_EQ(trusted_version("root"), 1);
}

TEST_F(SupplyChainAttack, RootWhoseNewKeyHasNotSigned) {
  const auto old = sim.signers["root"];
  sim.set_keys("root", {ed25519_key()});
  sim.signers["root"] = old;
  sim.publish_root();
  EXPECT_THAT(refresh(), HasSubstr("2.root.json is not signed by itself"));
}

TEST_F(SupplyChainAttack, ChangedContentUnderAGoodSignature) {
  Json file = Json::parse(sim.file("timestamp"));
  file["signed"]["expires"] = "2099-01-01T00:00:00Z";
  sim.served["timestamp.json"] = file.dump();
  EXPECT_THAT(refresh(), HasSubstr("timestamp.json is not signed"));
}

TEST_F(SupplyChainAttack, FileOfAnotherRole) {
  sim.set_keys("timestamp", sim.signers["snapshot"]);  // even where they share a key
  sim.publish_root();
  sim.served["timestamp.json"] = sim.file("snapshot");
  EXPECT_THAT(refresh(), HasSubstr("it is a file of the role 'snapshot', not of 'timestamp'"));
}

TEST_F(SupplyChainAttack, MemberThatStandsTwice) {
  std::string file = sim.file("timestamp");
  file.insert(file.find("\"version\""), "\"version\": 99, ");
  sim.served["timestamp.json"] = file;
  EXPECT_THAT(refresh(), HasSubstr("an object in it has 'version' twice"));
}

TEST_F(SupplyChainAttack, SpecificationOfAnotherGeneration) {
  sim.timestamp["spec_version"] = "2.0.0";
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("written to a version of the TUF specification that is not known here"));
}

// ---- rollback ----

TEST_F(SupplyChainAttack, RollbackOfTheRoot) {
  sim.publish_root();
  ASSERT_EQ(refresh(), "");
  sim.served["3.root.json"] = sim.roots[0];
  EXPECT_THAT(refresh(), HasSubstr("rollback: 3.root.json is of another version than its name says"));
}

TEST_F(SupplyChainAttack, RootThatSkipsAVersion) {
  sim.root["version"] = 2;
  sim.publish_root();
  sim.served["2.root.json"] = sim.roots.back();
  EXPECT_THAT(refresh(), AllOf(HasSubstr("2.root.json is of another version"), HasSubstr("found: version 3")));
}

TEST_F(SupplyChainAttack, RollbackOfTheTimestamp) {
  sim.timestamp["version"] = 1;
  EXPECT_THAT(refresh(), AllOf(HasSubstr("rollback: timestamp.json is older"), HasSubstr("version 2 or newer")));
}

TEST_F(SupplyChainAttack, RollbackOfTheSnapshot) {
  sim.snapshot["version"] = 1;
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("rollback: timestamp.json lists an older snapshot.json"));
}

TEST_F(SupplyChainAttack, RollbackOfTheTargets) {
  sim.targets["targets"]["version"] = 1;
  sim.publish_snapshot();
  EXPECT_THAT(refresh(), HasSubstr("rollback: snapshot.json lists an older targets.json"));
}

TEST_F(SupplyChainAttack, RollbackOfAPublisher) {
  sim.publish_targets("acme");
  ASSERT_EQ(refresh(), "");
  sim.targets["acme"]["version"] = 1;
  sim.publish_snapshot();
  EXPECT_THAT(refresh(), HasSubstr("rollback: snapshot.json lists an older acme.json"));
}

TEST_F(SupplyChainAttack, SnapshotLosesAPublisher) {
  sim.snapshot["meta"].erase("acme.json");
  sim.targets.erase("acme");
  sim.publish_snapshot();
  EXPECT_THAT(refresh(), HasSubstr("rollback: snapshot.json no longer lists acme.json"));
}

TEST_F(SupplyChainAttack, RollbackAfterTheTrustedTimestampHasExpired) {
  for (Json* body : {&sim.root, &sim.snapshot, &sim.targets["targets"], &sim.targets["acme"]}) {
    (*body)["expires"] = "2031-01-01T00:00:00Z";
  }
  sim.publish_root();
  sim.publish_targets();
  ASSERT_EQ(refresh(), "");
  sim.timestamp["expires"] = "2031-01-01T00:00:00Z";
  sim.timestamp["version"] = 1;
  EXPECT_THAT(refresh(Simulator::day(60)), HasSubstr("rollback: timestamp.json is older"));
}

TEST_F(SupplyChainAttack, RollbackByARefreshThatFailsHalfWay) {
  sim.publish_targets();
  sim.withheld["3.snapshot.json"] = true;
  EXPECT_THAT(refresh(), HasSubstr("the repository has no 3.snapshot.json"));
  sim.timestamp["version"] = 2;
  EXPECT_THAT(refresh(), HasSubstr("rollback: timestamp.json is older"));
}

// ---- freeze ----

TEST_F(SupplyChainAttack, FrozenTimestamp) {
  sim.timestamp["expires"] = "2030-01-02T00:00:00Z";
  sim.publish_timestamp();
  ASSERT_EQ(refresh(), "");
  EXPECT_THAT(refresh(Simulator::day(2)), HasSubstr("freeze: timestamp.json has expired"));
}

TEST_F(SupplyChainAttack, FrozenSnapshot) {
  sim.snapshot["expires"] = "2030-01-02T00:00:00Z";
  sim.publish_snapshot();
  EXPECT_THAT(refresh(Simulator::day(1)), HasSubstr("freeze: snapshot.json has expired"));
}

TEST_F(SupplyChainAttack, FrozenTargets) {
  sim.targets["targets"]["expires"] = "2030-01-02T00:00:00Z";
  sim.publish_targets();
  EXPECT_THAT(refresh(Simulator::day(3)), HasSubstr("freeze: targets.json has expired"));
}

TEST_F(SupplyChainAttack, FrozenPublisher) {
  sim.targets["acme"]["expires"] = "2030-01-02T00:00:00Z";
  sim.publish_targets("acme");
  EXPECT_THAT(download("acme/steps", Simulator::day(3)), HasSubstr("freeze: acme.json has expired"));
}

TEST_F(SupplyChainAttack, FrozenRoot) {
  EXPECT_THAT(refresh(Simulator::day(30)), AllOf(HasSubstr("freeze: root.json has expired"), HasSubstr("date -u")));
}

TEST_F(SupplyChainAttack, ExpiredTimestampIsNotKept) {
  sim.timestamp["expires"] = "2029-12-31T00:00:00Z";
  sim.publish_timestamp();
  EXPECT_THAT(refresh(), HasSubstr("freeze: timestamp.json has expired"));
  EXPECT_EQ(trusted_version("timestamp"), 2);
}

// ---- mix and match ----

TEST_F(SupplyChainAttack, MixAndMatchOfASnapshot) {
  const std::string old = sim.file("snapshot");
  sim.publish_snapshot();
  sim.served["3.snapshot.json"] = old;
  EXPECT_THAT(refresh(), HasSubstr("mix and match: snapshot.json has not the"));
}

TEST_F(SupplyChainAttack, MixAndMatchOfASnapshotWithoutHashes) {
  sim.list_hashes = false;
  const std::string old = sim.file("snapshot");
  sim.publish_snapshot();
  sim.served["3.snapshot.json"] = old;
  EXPECT_THAT(refresh(), HasSubstr("mix and match: snapshot.json is not the version that timestamp.json lists"));
}

TEST_F(SupplyChainAttack, MixAndMatchOfTargets) {
  sim.list_hashes = false;
  const std::string old = sim.file("targets");
  sim.publish_targets();
  sim.served["3.targets.json"] = old;
  EXPECT_THAT(refresh(), HasSubstr("mix and match: targets.json is not the version that snapshot.json lists"));
}

TEST_F(SupplyChainAttack, MixAndMatchOfAPublisher) {
  const std::string old = sim.file("acme");
  sim.publish_targets("acme");
  sim.served["2.acme.json"] = old;
  EXPECT_THAT(attacked_download(), HasSubstr("mix and match: acme.json has not the"));
}

TEST_F(SupplyChainAttack, TwoFilesOfOneVersion) {
  sim.publish_snapshot();
  sim.snapshot["expires"] = "2030-01-30T00:00:00Z";  // after the timestamp listed it
  EXPECT_THAT(refresh(), HasSubstr("mix and match: snapshot.json has not the hash that timestamp.json lists"));
}

TEST_F(SupplyChainAttack, PublisherThatTheSnapshotDoesNotList) {
  sim.delegate("targets", "ghost", {"ghost/*"});
  sim.publish_targets();
  sim.snapshot["meta"].erase("ghost.json");
  sim.snapshot["version"] = 4;
  sim.publish_timestamp();
  EXPECT_THAT(download("ghost/x"), HasSubstr("snapshot.json does not list ghost.json"));
}

// ---- endless data, and what breaks readers ----

TEST_F(SupplyChainAttack, EndlessRoot) {
  sim.served["2.root.json"] = std::string(1 << 20, ' ');
  EXPECT_THAT(refresh(), HasSubstr("endless data"));
}

TEST_F(SupplyChainAttack, EndlessTimestamp) {
  sim.served["timestamp.json"] = std::string(1 << 20, ' ');
  EXPECT_THAT(refresh(), HasSubstr("endless data"));
}

TEST_F(SupplyChainAttack, SnapshotLongerThanTheTimestampSays) {
  sim.publish_snapshot();
  sim.served["3.snapshot.json"] = sim.file("snapshot") + " ";
  EXPECT_THAT(refresh(), HasSubstr("endless data"));
}

TEST_F(SupplyChainAttack, EndlessTargetsWithoutAListedLength) {
  sim.list_hashes = false;
  sim.publish_targets();
  sim.served["3.targets.json"] = std::string(9 << 20, ' ');
  EXPECT_THAT(refresh(), HasSubstr("endless data"));
}

TEST_F(SupplyChainAttack, BottomlessNesting) {
  sim.served["timestamp.json"] = std::string(30'000, '[');
  EXPECT_THAT(refresh(), HasSubstr("nested more than 32 levels deep"));
}

TEST_F(SupplyChainAttack, EmptyFile) {
  sim.served["timestamp.json"] = "";
  EXPECT_THAT(refresh(), HasSubstr("timestamp.json is not TUF metadata: JSON ends or breaks at byte"));
}

TEST_F(SupplyChainAttack, WithheldMetadata) {
  sim.withheld["timestamp.json"] = true;
  EXPECT_THAT(refresh(), HasSubstr("the repository has no timestamp.json"));
}

TEST_F(SupplyChainAttack, WithheldTarget) {
  sim.withheld[served_target()] = true;
  EXPECT_THAT(attacked_download(), HasSubstr("has signed for acme/steps and does not have it"));
}

TEST_F(SupplyChainAttack, FastForwardIsRecoveredFromByNewKeysOnly) {
  sim.timestamp["version"] = 1'000'000;
  ASSERT_EQ(refresh(), "");
  sim.timestamp["version"] = 3;
  EXPECT_THAT(refresh(), HasSubstr("rollback: timestamp.json is older"));
  sim.set_keys("timestamp", {ed25519_key()});
  sim.publish_root();
  EXPECT_EQ(refresh(), "");
}

}  // namespace
}  // namespace fiona::tuf::testing
