// The client workflow of the TUF specification, section 5, step by step, against a repository in memory.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fiona/error.hpp>

#include "tuf_simulator.hpp"

namespace fiona::tuf::testing {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

class TufWorkflow : public ::testing::Test, protected TufTest {
 protected:
  Simulator& sim = *repository;
};

TEST_F(TufWorkflow, RefreshKeepsTheFourTopLevelRoles) {
  EXPECT_EQ(refresh(), "");
  for (const auto& role : {"root", "timestamp", "snapshot", "targets"}) EXPECT_EQ(trusted_version(role), 1) << role;
}

TEST_F(TufWorkflow, FilesAreAskedForInTheOrderOfTheSpecification) {
  EXPECT_EQ(refresh(), "");
  EXPECT_THAT(sim.requests, ElementsAre("2.root.json", "timestamp.json", "1.snapshot.json", "1.targets.json"));
}

TEST_F(TufWorkflow, WithoutConsistentSnapshotsNamesHaveNoVersion) {
  sim.root["consistent_snapshot"] = false;
  sim.publish_root();
  EXPECT_EQ(refresh(), "");
  EXPECT_THAT(sim.requests,
              ElementsAre("2.root.json", "3.root.json", "timestamp.json", "snapshot.json", "targets.json"));
}

TEST_F(TufWorkflow, ARootThatDoesNotSayHasNoConsistentSnapshots) {
  sim.root.erase("consistent_snapshot");
  sim.root["version"] = 2;
  sim.roots.push_back(signed_file(sim.root, sim.signers["root"]));
  sim.root["consistent_snapshot"] = false;  // as the simulator serves
  EXPECT_EQ(refresh(), "");
  EXPECT_THAT(sim.requests, Contains("snapshot.json"));
}

TEST_F(TufWorkflow, TheStartTimeIsReadOnceForARefresh) {
  int asked = 0;
  ClientOptions options = this->options();
  options.now = [&asked] { return Simulator::day(asked++ == 0 ? 0 : 400); };
  Client client{options};
  asked = 0;
  EXPECT_NO_THROW(client.refresh());
  EXPECT_EQ(asked, 1);
}

TEST_F(TufWorkflow, AnExpiredTrustedRootMayBeUpdated) {
  sim.root["expires"] = "2031-01-01T00:00:00Z";
  sim.publish_root();
  for (Json* body : {&sim.timestamp, &sim.snapshot, &sim.targets["targets"]}) {
    (*body)["expires"] = "2031-01-01T00:00:00Z";
  }
  sim.publish_targets();
  EXPECT_EQ(refresh(Simulator::day(60)), "");
  EXPECT_EQ(trusted_version("root"), 2);
}

TEST_F(TufWorkflow, RootsAreFollowedOneByOneThroughChangesOfKeys) {
  std::vector<TestKey> before = sim.signers["root"];
  for (int i = 0; i < 3; ++i) {
    const std::vector<TestKey> next{ed25519_key()};
    sim.set_keys("root", next);
    sim.signers["root"] = {before[0], next[0]};
    sim.publish_root();
    before = next;
  }
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(trusted_version("root"), 4);
  EXPECT_THAT(sim.requests, Contains("5.root.json"));
}

TEST_F(TufWorkflow, AnIntermediateRootMayHaveExpired) {
  sim.root["expires"] = "2029-01-01T00:00:00Z";
  sim.publish_root();
  sim.root["expires"] = "2030-01-31T00:00:00Z";
  sim.publish_root();
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(trusted_version("root"), 3);
}

TEST_F(TufWorkflow, RootsBeforeTheOneThatFailsAreKept) {
  sim.publish_root();
  sim.publish_root();
  sim.served["3.root.json"] = signed_file(sim.root, {ed25519_key()});
  EXPECT_THAT(refresh(), HasSubstr("3.root.json is not signed by the root before it"));
  EXPECT_EQ(trusted_version("root"), 2);
}

TEST_F(TufWorkflow, NoMoreRootsAreFetchedThanTheLimitAllows) {
  for (int i = 0; i < 5; ++i) sim.publish_root();
  ClientOptions options = this->options();
  options.limits.root_updates = 2;
  Client{options}.refresh();
  EXPECT_EQ(trusted_version("root"), 3);
}

TEST_F(TufWorkflow, AnExpiredRootEndsTheRefreshBeforeAnythingElseIsFetched) {
  EXPECT_THAT(refresh(Simulator::day(31)), HasSubstr("freeze: root.json has expired"));
  EXPECT_THAT(sim.requests, ElementsAre("2.root.json"));
}

TEST_F(TufWorkflow, ATimestampOfTheSameVersionIsNoRollback) {
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(refresh(), "");
}

TEST_F(TufWorkflow, ATimestampOfTheSameVersionDoesNotReplaceTheTrustedOne) {
  EXPECT_EQ(refresh(), "");
  const std::string before = trusted_file("timestamp.json");
  sim.timestamp["expires"] = "2030-01-30T00:00:00Z";
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(trusted_file("timestamp.json"), before);
}

TEST_F(TufWorkflow, WhatIsStillCurrentIsNotFetchedAgain) {
  EXPECT_EQ(refresh(), "");
  sim.requests.clear();
  EXPECT_EQ(refresh(), "");
  EXPECT_THAT(sim.requests, ElementsAre("2.root.json", "timestamp.json"));
}

TEST_F(TufWorkflow, LengthsAndHashesOfMetadataNeedNotBeListed) {
  sim.list_hashes = false;
  sim.publish_targets();
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(trusted_version("targets"), 2);
}

TEST_F(TufWorkflow, HashesOfSeveralAlgorithmsAreAllChecked) {
  sim.timestamp["meta"]["snapshot.json"]["hashes"]["sha512"] = std::string(128, '0');
  EXPECT_THAT(refresh(), HasSubstr("snapshot.json has not the hash that timestamp.json lists"));
}

TEST_F(TufWorkflow, AHashOfAnAlgorithmNotKnownHereIsLetBeBesideOneThatIs) {
  sim.timestamp["meta"]["snapshot.json"]["hashes"]["md7"] = "00";
  EXPECT_EQ(refresh(), "");
}

TEST_F(TufWorkflow, UnknownMembersAreLetBeAndSignedFor) {
  sim.root["x-made-by"] = {{"tool", "other"}, {"years", {2029, 2030}}, {"none", nullptr}};
  sim.publish_root();
  sim.timestamp["x"] = true;
  sim.publish_timestamp();
  EXPECT_EQ(refresh(), "");
  EXPECT_THAT(trusted_file("root.json"), HasSubstr("x-made-by"));
}

TEST_F(TufWorkflow, ChangedTimestampKeysForgetTimestampAndSnapshot) {
  sim.timestamp["version"] = 99;
  sim.snapshot["version"] = 88;
  sim.publish_timestamp();
  EXPECT_EQ(refresh(), "");
  sim.set_keys("timestamp", {ed25519_key()});
  sim.publish_root();
  sim.timestamp["version"] = 1;
  sim.snapshot["version"] = 1;
  sim.publish_timestamp();
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(trusted_version("timestamp"), 2);
  EXPECT_EQ(trusted_version("snapshot"), 1);
}

TEST_F(TufWorkflow, ChangedSnapshotKeysForgetTheVersionsOfTargets) {
  sim.targets["targets"]["version"] = 99;
  sim.publish_snapshot();
  EXPECT_EQ(refresh(), "");
  sim.set_keys("snapshot", {ed25519_key()});
  sim.publish_root();
  sim.targets["targets"]["version"] = 2;
  sim.publish_snapshot();
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(trusted_version("targets"), 2);
}

TEST_F(TufWorkflow, AKeyAddedToTheTimestampRoleForgetsToo) {
  const TestKey old = sim.signers["timestamp"][0];
  sim.timestamp["version"] = 99;
  EXPECT_EQ(refresh(), "");
  sim.set_keys("timestamp", {old, ed25519_key()});
  sim.publish_root();
  sim.timestamp["version"] = 1;
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(trusted_version("timestamp"), 1);
}

TEST_F(TufWorkflow, ChangedTargetsKeysForgetNothing) {
  EXPECT_EQ(refresh(), "");
  sim.publish_timestamp();
  EXPECT_EQ(refresh(), "");
  sim.set_keys("targets", {ed25519_key()});
  sim.publish_root();
  sim.publish_targets();
  sim.timestamp["version"] = 1;
  EXPECT_THAT(refresh(), HasSubstr("rollback: timestamp.json is older than the one that is trusted"));
}

TEST_F(TufWorkflow, DamagedTrustedFilesButTheRootAreFetchedAgain) {
  EXPECT_EQ(refresh(), "");
  for (const auto& name : {"timestamp.json", "snapshot.json", "targets.json"}) {
    marketplace::testing::write_file(trusted / name, "not metadata");
  }
  EXPECT_EQ(refresh(), "");
  for (const auto& role : {"timestamp", "snapshot", "targets"}) EXPECT_EQ(trusted_version(role), 1) << role;
}

TEST_F(TufWorkflow, ADamagedTrustedRootIsAnError) {
  marketplace::testing::write_file(trusted / "root.json", "{}");
  EXPECT_THAT(refresh(), HasSubstr("root.json is not TUF metadata: 'signed' is missing"));
}

TEST_F(TufWorkflow, ATrustedRootThatWasChangedOnDiskIsAnError) {
  std::string root = trusted_file("root.json");
  root.replace(root.find("2030-01-31"), 4, "2099");
  marketplace::testing::write_file(trusted / "root.json", root);
  EXPECT_THAT(refresh(), HasSubstr("root.json is not signed by itself"));
}

TEST_F(TufWorkflow, WithoutATrustedRootTheNextStepIsSaid) {
  std::filesystem::remove_all(trusted);
  EXPECT_THAT(refresh(), HasSubstr("no root is trusted for this repository"));
  EXPECT_THAT(refresh(), HasSubstr("fiona keys trust FILE"));
}

TEST_F(TufWorkflow, AFailedRefreshLeavesWhatTheNextCanGoOnFrom) {
  EXPECT_EQ(refresh(), "");
  sim.publish_targets();
  sim.withheld["2.targets.json"] = true;
  EXPECT_THAT(refresh(), HasSubstr("the repository has no 2.targets.json"));
  EXPECT_EQ(trusted_version("snapshot"), 2);
  EXPECT_EQ(trusted_version("targets"), 1);
  sim.withheld.clear();
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(trusted_version("targets"), 2);
}

TEST_F(TufWorkflow, ATargetIsDownloadedUnderItsEncodedPath) {
  sim.add_target("targets", "dir/a file.txt", "content");
  sim.publish_targets();
  EXPECT_EQ(download("dir/a file.txt"), "");
  EXPECT_EQ(marketplace::testing::file_content(downloads / "dir%2Fa%20file.txt"), "content");
}

TEST_F(TufWorkflow, AConsistentTargetHasItsHashInItsName) {
  sim.add_target("targets", "dir/file.txt", "content");
  sim.publish_targets();
  EXPECT_EQ(download("dir/file.txt"), "");
  EXPECT_EQ(sim.requests.back(), "dir/" + sha256_text("content") + ".file.txt");
}

TEST_F(TufWorkflow, WithoutConsistentSnapshotsATargetHasItsOwnName) {
  sim.root["consistent_snapshot"] = false;
  sim.publish_root();
  sim.add_target("targets", "dir/file.txt", "content");
  sim.publish_targets();
  EXPECT_EQ(download("dir/file.txt"), "");
  EXPECT_EQ(sim.requests.back(), "dir/file.txt");
}

TEST_F(TufWorkflow, WhatIsThereAlreadyIsNotDownloadedAgain) {
  sim.add_target("targets", "file.txt", "content");
  sim.publish_targets();
  EXPECT_EQ(download("file.txt"), "");
  sim.requests.clear();
  EXPECT_EQ(download("file.txt"), "");
  EXPECT_THAT(sim.requests, Not(Contains(HasSubstr("file.txt"))));
}

TEST_F(TufWorkflow, WhatIsThereWithOtherContentIsReplaced) {
  sim.add_target("targets", "file.txt", "content");
  sim.publish_targets();
  std::filesystem::create_directories(downloads);
  marketplace::testing::write_file(downloads / "file.txt", "kontent");
  EXPECT_EQ(download("file.txt"), "");
  EXPECT_EQ(marketplace::testing::file_content(downloads / "file.txt"), "content");
}

TEST_F(TufWorkflow, AnEmptyTargetIsATarget) {
  sim.add_target("targets", "empty", "");
  sim.publish_targets();
  EXPECT_EQ(download("empty"), "");
  EXPECT_TRUE(std::filesystem::exists(downloads / "empty"));
}

TEST_F(TufWorkflow, ATargetThatNobodySpeaksOfIsNotFound) {
  EXPECT_THAT(download("absent"), HasSubstr("nobody who may has signed for a target absent"));
}

TEST_F(TufWorkflow, CustomDataOfATargetIsHandedOn) {
  sim.add_target("targets", "file", "content");
  sim.targets["targets"]["targets"]["file"]["custom"] = {{"channel", "stable"}};
  sim.publish_targets();
  Client client{options()};
  client.refresh();
  EXPECT_EQ(client.target("file").custom, R"({"channel":"stable"})");
}

TEST_F(TufWorkflow, TwoClientsOfOneDirectoryDoNotHinderEachOther) {
  sim.add_target("targets", "file", "content");
  sim.publish_targets();
  Client one{options()};
  one.refresh();
  EXPECT_EQ(refresh(), "");
  EXPECT_EQ(one.target("file").length, 7U);
}

TEST_F(TufWorkflow, ATrustedDirectoryMayBeTheDownloadDirectoryToo) {
  sim.add_target("targets", "file", "content");
  sim.publish_targets();
  Client client{options()};
  client.refresh();
  EXPECT_EQ(client.download(client.target("file"), trusted), trusted / "file");
}

// ---- delegations ----

class TufDelegations : public TufWorkflow {
 protected:
  // The roles that a search visits, in order.
  std::vector<std::string> visited(const std::string& target) {
    EXPECT_EQ(refresh(), "");
    sim.requests.clear();
    Client client{options()};
    client.refresh();
    try {
      client.target(target);
    } catch (const Error&) {
    }
    std::vector<std::string> roles;
    for (const auto& name : sim.requests) {
      if (name == "2.root.json" || name == "timestamp.json") continue;
      roles.push_back(name.substr(2, name.size() - 7));  // without "1." and ".json"
    }
    return roles;
  }
};

TEST_F(TufDelegations, ADelegatedRoleSpeaksForItsPaths) {
  sim.delegate("targets", "acme", {"acme/*"});
  sim.add_target("acme", "acme/steps", "content");
  sim.publish_targets();
  EXPECT_EQ(download("acme/steps"), "");
  EXPECT_EQ(trusted_version("acme"), 1);
}

TEST_F(TufDelegations, WhoHasSignedForATargetIsTold) {
  sim.delegate("targets", "acme", {"acme/*"});
  sim.delegate("targets", "other", {"other/*", "acme/nested"});
  sim.delegate("other", "acme", {"acme/nested"});
  sim.add_target("acme", "acme/steps", "content");
  sim.add_target("targets", "acme/by-the-keeper", "content");
  sim.publish_targets();
  Client client{options()};
  client.refresh();
  EXPECT_EQ(client.target("acme/steps").signer, "acme");
  EXPECT_EQ(client.target("acme/by-the-keeper").signer, "") << "whose name is no publisher's";
}

TEST_F(TufDelegations, TheSearchIsPreOrderAndDepthFirst) {
  sim.delegate("targets", "a", {"*"});
  sim.delegate("targets", "d", {"*"});
  sim.delegate("a", "b", {"*"});
  sim.delegate("a", "c", {"*"});
  sim.publish_snapshot();
  EXPECT_THAT(visited("x"), ElementsAre("a", "b", "c", "d"));
}

TEST_F(TufDelegations, RolesThatAreNotTrustedForThePathAreNotVisited) {
  sim.delegate("targets", "a", {"other/*"});
  sim.delegate("targets", "b", {"x"});
  sim.publish_snapshot();
  EXPECT_THAT(visited("x"), ElementsAre("b"));
}

TEST_F(TufDelegations, ATerminatingRoleEndsTheSearchAfterItsOwnDelegations) {
  sim.delegate("targets", "a", {"*"});
  sim.delegate("targets", "d", {"*"});
  sim.delegate("a", "b", {"*"}, true);
  sim.delegate("a", "c", {"*"});
  sim.delegate("b", "e", {"*"});
  sim.publish_snapshot();
  EXPECT_THAT(visited("x"), ElementsAre("a", "b", "e"));
}

TEST_F(TufDelegations, ATerminatingRoleForOtherPathsEndsNothing) {
  sim.delegate("targets", "a", {"other"}, true);
  sim.delegate("targets", "b", {"*"});
  sim.publish_snapshot();
  EXPECT_THAT(visited("x"), ElementsAre("b"));
}

TEST_F(TufDelegations, TheFirstRoleThatSpeaksOfATargetDecides) {
  sim.delegate("targets", "first", {"*"});
  sim.delegate("targets", "second", {"*"});
  sim.add_target("second", "x", "of the second");
  sim.add_target("first", "x", "of the first");
  sim.publish_targets();
  EXPECT_EQ(download("x"), "");
  EXPECT_EQ(marketplace::testing::file_content(downloads / "x"), "of the first");
}

TEST_F(TufDelegations, HashPrefixesChooseBins) {
  const std::string first(1, sha256_text("x")[0]);
  Json& even = sim.delegate("targets", "wrong-bin", {});
  even.erase("paths");
  even["path_hash_prefixes"] = {first == "0" ? "1" : "0"};
  Json& odd = sim.delegate("targets", "bin", {});
  odd.erase("paths");
  odd["path_hash_prefixes"] = {first};
  sim.add_target("bin", "x", "content");
  sim.publish_targets();
  EXPECT_EQ(download("x"), "");
  EXPECT_EQ(trusted_version("wrong-bin"), 0);
}

TEST_F(TufDelegations, RolesWithUnusualNamesHaveEncodedFiles) {
  sim.delegate("targets", "../a b", {"*"});
  sim.add_target("../a b", "x", "content");
  sim.publish_targets();
  EXPECT_EQ(download("x"), "");
  EXPECT_TRUE(std::filesystem::exists(trusted / "..%2Fa%20b.json"));
  EXPECT_THAT(sim.requests, Contains("1...%2Fa%20b.json"));
}

TEST_F(TufDelegations, ARoleMayEvenBeNamedAsADirectory) {
  for (const auto& role : {".", ".."}) sim.delegate("targets", role, {std::string(role) + "*"});
  sim.add_target("..", "..x", "content");
  sim.publish_targets();
  EXPECT_EQ(download("..x"), "");
  EXPECT_TRUE(std::filesystem::exists(trusted / "...json"));
}

TEST_F(TufWorkflow, ATargetNamedAsADirectoryIsAFile) {
  sim.add_target("targets", "..", "content");
  sim.publish_targets();
  EXPECT_EQ(download(".."), "");
  EXPECT_TRUE(std::filesystem::is_regular_file(downloads / "%2E%2E"));
}

TEST_F(TufDelegations, AThresholdOfADelegationIsKept) {
  sim.signers["acme"] = {ed25519_key(), ed25519_key()};
  sim.targets["acme"] = sim.targets["targets"];
  Json& delegation = sim.delegate("targets", "acme", {"acme/*"});
  delegation["threshold"] = 2;
  sim.add_target("acme", "acme/x", "content");
  sim.publish_targets();
  EXPECT_EQ(download("acme/x"), "");
}

TEST_F(TufDelegations, ANewVersionOfADelegatedRoleIsSeen) {
  sim.delegate("targets", "acme", {"acme/*"});
  sim.add_target("acme", "acme/x", "content");
  sim.publish_targets();
  EXPECT_EQ(download("acme/x"), "");
  sim.add_target("acme", "acme/y", "more");
  sim.publish_targets("acme");
  EXPECT_EQ(download("acme/y"), "");
  EXPECT_EQ(trusted_version("acme"), 2);
}

// ---- kinds of keys ----

class TufKeyKinds : public TufWorkflow, public ::testing::WithParamInterface<std::pair<const char*, TestKey (*)()>> {};

TEST_P(TufKeyKinds, ARepositoryOfThisKindOfKeyIsAccepted) {
  sim.list_hashes = false;  // some signatures differ each time
  for (const auto& role : {"timestamp", "snapshot", "targets"}) sim.set_keys(role, {GetParam().second()});
  sim.publish_root();
  sim.publish_targets();
  EXPECT_EQ(refresh(), "");
}

TEST_P(TufKeyKinds, ASignatureOfOtherBytesIsRefused) {
  sim.set_keys("timestamp", {GetParam().second()});
  sim.publish_root();
  Json other = sim.timestamp;
  other["version"] = 7;
  Json file = Json::parse(sim.file("timestamp"));
  file["signatures"] = Json::parse(signed_file(other, sim.signers["timestamp"]))["signatures"];
  sim.served["timestamp.json"] = file.dump();
  EXPECT_THAT(refresh(), HasSubstr("timestamp.json is not signed by the role 'timestamp'"));
}

INSTANTIATE_TEST_SUITE_P(Kinds, TufKeyKinds,
                         ::testing::Values(std::pair{"Ed25519", +[] { return ed25519_key(); }},
                                           std::pair{"Ecdsa", +[] { return ecdsa_key("ecdsa"); }},
                                           std::pair{"EcdsaOfTheOlderName",
                                                     +[] { return ecdsa_key("ecdsa-sha2-nistp256"); }},
                                           std::pair{"RsaPss", +[] { return rsa_key("rsassa-pss-sha256"); }},
                                           std::pair{"RsaPkcs1", +[] { return rsa_key("rsa-pkcs1v15-sha256"); }}),
                         [](const auto& kind) { return kind.param.first; });

}  // namespace
}  // namespace fiona::tuf::testing
