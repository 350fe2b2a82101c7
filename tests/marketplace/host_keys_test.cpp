// The keys of hosts: who may read them, what a damaged file does, and who may connect.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <fstream>
#include <optional>

#include "fiona/error.hpp"
#include "fiona/trust/host_keys.hpp"
#include "support.hpp"

namespace fiona::trust {
namespace {

using marketplace::testing::error_of;
using ::testing::HasSubstr;

class Keys : public ::testing::Test {
 protected:
  void write(const std::string& name, const std::string& text) { std::ofstream(directory / name) << text; }
  marketplace::testing::Scratch directory;
  KeyDirectory keys{directory.path()};
};

TEST_F(Keys, PairIsMadeForItsUserAloneAndReadAgain) {
  const KeyPair made = keys.make();
  struct stat status {};
  ASSERT_EQ(::stat((directory / "host.key").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600U);
  EXPECT_EQ(keys.pair().secret, made.secret);
  EXPECT_EQ(keys.pair().open, made.open) << "worked out from the secret one";
}

TEST_F(Keys, PairThatIsThereIsNotOverwritten) {
  const KeyPair made = keys.make();
  const Error error = error_of([&] { keys.make(); });
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error.text().what, "there is a key pair already, and other hosts may know this one by it");
  EXPECT_EQ(keys.pair().open, made.open);
}

TEST_F(Keys, PairThatOthersMayReadIsRefused) {
  keys.make();
  ::chmod((directory / "host.key").c_str(), 0640);
  const Error error = error_of([&] { keys.pair(); });
  EXPECT_EQ(error.code(), ErrorCode::NotAllowed);
  EXPECT_EQ(error.text().what, "the secret key is not private to this user");
}

TEST_F(Keys, WithoutAPairTheErrorSaysHowToMakeOne) {
  const Error error = error_of([&] { keys.pair(); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_EQ(error.text().what, "tcp needs keys, and this user has none");
  EXPECT_EQ(error.text().next, "fiona keys make");
}

TEST_F(Keys, EveryTruncationOfThePairIsRefusedInASentence) {
  keys.make();
  std::ifstream file(directory / "host.key");
  const std::string whole{std::istreambuf_iterator<char>(file), {}};
  ASSERT_EQ(whole.size(), 82U);
  for (std::size_t size = 0; size + 1 < whole.size(); ++size) {
    write("host.key", whole.substr(0, size));
    EXPECT_EQ(error_of([&] { keys.pair(); }).text().what, "the key pair is damaged") << size;
  }
}

TEST_F(Keys, AllowedHostsAreKeptInOrderUntilForgotten) {
  const std::string a(64, 'a');
  const std::string b(64, 'b');
  keys.allow("first", a);
  keys.allow("second", b);
  ASSERT_EQ(keys.allowed().size(), 2U);
  EXPECT_EQ(keys.allowed()[1].name, "second");
  EXPECT_EQ(keys.allowed()[1].key.text(), b);
  keys.forget("first");
  ASSERT_EQ(keys.allowed().size(), 1U);
  EXPECT_EQ(keys.allowed()[0].name, "second");
}

TEST_F(Keys, OneNameAndOneKeyAreAllowedOnce) {
  keys.allow("first", std::string(64, 'a'));
  EXPECT_EQ(error_of([&] { keys.allow("first", std::string(64, 'b')); }).text().what,
            "there is a host 'first' in the list already");
  EXPECT_EQ(error_of([&] { keys.allow("second", std::string(64, 'a')); }).text().what,
            "the key is in the list already, as 'first'");
}

TEST_F(Keys, WhatIsNoKeyOrNameIsRefusedAndWhereToGetOneIsSaid) {
  const Error error = error_of([&] { keys.allow("first", "abc"); });
  EXPECT_EQ(error.text().expected, "64 hexadecimal digits");
  EXPECT_EQ(error.text().next, "on the other host: fiona keys show");
  EXPECT_EQ(error_of([&] { keys.allow("a b", std::string(64, 'a')); }).code(), ErrorCode::Usage);
}

TEST_F(Keys, ForgettingAnUnknownHostNamesTheNearest) {
  keys.allow("kitchen", std::string(64, 'a'));
  EXPECT_THAT(error_of([&] { keys.forget("kitchn"); }).text().near, ::testing::ElementsAre("kitchen"));
}

TEST_F(Keys, AConsoleIsNoHostAndAHostNoConsole) {
  keys.allow("office", std::string(64, 'a'));
  EXPECT_TRUE(keys.consoles().empty());
  keys.allow_console("desk", std::string(64, 'b'), Access::Operate);
  EXPECT_EQ(keys.allowed().size(), 1U);
  ASSERT_EQ(keys.consoles().size(), 1U);
  EXPECT_EQ(keys.consoles()[0].name, "desk");
  EXPECT_EQ(keys.consoles()[0].level, Access::Operate);
  keys.allow_console("office", std::string(64, 'a'), Access::Observe);
  EXPECT_EQ(keys.consoles().size(), 2U) << "one key may be both, if it is said twice";
}

TEST_F(Keys, AConsoleThatIsAllowedAgainGetsTheNewLevelAndAnotherKeyDoesNot) {
  keys.allow_console("desk", std::string(64, 'b'), Access::Operate);
  keys.allow_console("desk", std::string(64, 'B'), Access::Compose);
  ASSERT_EQ(keys.consoles().size(), 1U);
  EXPECT_EQ(keys.consoles()[0].level, Access::Compose);
  const Error error = error_of([&] { keys.allow_console("desk", std::string(64, 'c'), Access::Administer); });
  EXPECT_EQ(error.text().what, "there is a console 'desk' in the list already");
}

TEST_F(Keys, AListOfConsolesWithAnUnknownLevelLetsNoneIn) {
  write("consoles.allowed", "desk " + std::string(64, 'b') + " king\n");
  const Error error = error_of([&] { keys.consoles(); });
  EXPECT_EQ(error.text().what, "the list of consoles that may connect is damaged: none may until it is mended");
  EXPECT_THAT(error.text().where, HasSubstr("consoles.allowed:1"));
}

TEST_F(Keys, AKnownHostIsFoundByItsNameAndTheLastAddressCounts) {
  keys.know("kitchen", "192.168.1.20:7002", std::string(64, 'a'));
  keys.know("kitchen", "[fe80::1]:7002", std::string(64, 'a'));
  ASSERT_EQ(keys.known().size(), 1U);
  EXPECT_EQ(keys.known()[0].address, "[fe80::1]:7002");
  for (const char* wrong : {"", "kitchen", ":7002", "kitchen:", "kitchen:http", "kitchen:123456", "a b:1", "a=b:1"}) {
    EXPECT_EQ(error_of([&] { keys.know("kitchen", wrong, std::string(64, 'a')); }).code(), ErrorCode::Usage) << wrong;
  }
}

TEST_F(Keys, ForgettingTakesANameFromEachList) {
  keys.allow("office", std::string(64, 'a'));
  keys.allow_console("office", std::string(64, 'a'), Access::Observe);
  keys.know("office", "office:7002", std::string(64, 'a'));
  keys.forget("office");
  EXPECT_TRUE(keys.allowed().empty() && keys.consoles().empty() && keys.known().empty());
}

TEST_F(Keys, DamagedListNamesTheLineAndLetsNobodyIn) {
  write("hosts.allowed", "# people may write here\nfirst " + std::string(64, 'a') + "\nsecond zz\n");
  const Error error = error_of([&] { keys.allowed(); });
  EXPECT_THAT(error.text().where, HasSubstr("hosts.allowed:3"));
  EXPECT_THAT(error.text().what, HasSubstr("nobody may until it is mended"));
}

}  // namespace
}  // namespace fiona::trust
