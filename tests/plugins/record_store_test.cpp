// The database of users and profiles: what it keeps, and that it tells its damage.
#include "fiona/records/record_store.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>
#include <string>

#include "../damage.hpp"
#include "../temporary_directory.hpp"
#include "fiona/error.hpp"

namespace fiona::records {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pair;

class RecordStoreTest : public ::testing::Test {
 protected:
  /// Why it does not open, or how a look into it ends; empty: it opens, and holds what `said` says.
  std::string refusal(std::map<std::string, std::string>* said = nullptr) const {
    try {
      const RecordStore store(file_, kind_);
      const auto all = store.all("account");
      if (said) *said = all;
      return {};
    } catch (const Error& error) {
      return error.what();
    }
  }
  void fill() const {
    RecordStore store(file_, kind_);
    for (int i = 0; i < 40; ++i) store.put("account", "user" + std::to_string(i), std::string(100, 'a' + i % 26));
  }
  std::filesystem::path key() const { return file_.string() + ".key"; }

  std::string kind_ = "users";
  tests::TemporaryDirectory folder_;
  std::filesystem::path file_ = folder_.path / "deep/users.db";
};

TEST_F(RecordStoreTest, WhatIsPutIsThereWhenItIsOpenedAgain) {
  {
    RecordStore store(file_, "users");
    store.put("account", "anna", "1");
    store.put("account", "anna", std::string("\0two", 4));
    store.put("account", "bert", "");
    store.put("session", "anna", "other");
    EXPECT_TRUE(store.erase("session", "anna"));
    EXPECT_FALSE(store.erase("session", "anna"));
  }
  const RecordStore store(file_, "users");
  EXPECT_THAT(store.all("account"), ElementsAre(Pair("anna", std::string("\0two", 4)), Pair("bert", "")));
  EXPECT_EQ(store.get("account", "anna"), std::string("\0two", 4));
  EXPECT_EQ(store.get("session", "anna"), std::nullopt);
}

TEST_F(RecordStoreTest, OnlyItsOwnerReadsIt) {
  fill();
  const RecordStore open(file_, "users");
  for (const char* ending : {"", ".key", "-wal", "-shm"}) {
    struct stat found {};
    ASSERT_EQ(::stat((file_.string() + ending).c_str(), &found), 0) << ending;
    EXPECT_EQ(found.st_mode & 0777, 0600U) << ending;
  }
}

TEST_F(RecordStoreTest, AnExchangeOfWhatHasChangedMeanwhileChangesNothing) {
  RecordStore store(file_, "users");
  EXPECT_TRUE(store.exchange("account", "anna", std::nullopt, "1"));
  EXPECT_FALSE(store.exchange("account", "anna", std::nullopt, "2"));
  EXPECT_FALSE(store.exchange("account", "anna", "0", "2"));
  EXPECT_TRUE(store.exchange("account", "anna", "1", "2"));
  EXPECT_EQ(store.get("account", "anna"), "2");
}

TEST_F(RecordStoreTest, AChangeByAnotherIsSeenByTheVersion) {
  RecordStore one(file_, "users");
  RecordStore other(file_, "users");
  const auto before = one.version();
  EXPECT_EQ(one.version(), before);
  other.put("account", "anna", "1");
  EXPECT_NE(one.version(), before);
  EXPECT_EQ(one.get("account", "anna"), "1");
}

TEST_F(RecordStoreTest, AnotherKindOfDatabaseIsRefused) {
  fill();
  try {
    const RecordStore store(file_, "profiles");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::Failed);
    EXPECT_STREQ(
        error.what(),
        (file_.string() + ": the database holds something else\n  expected: profiles\n  found: users").c_str());
  }
}

TEST_F(RecordStoreTest, AnEmptiedDatabaseIsNotTakenForANewOne) {
  fill();
  std::filesystem::resize_file(file_, 0);
  EXPECT_THAT(refusal(),
              HasSubstr("the database is empty or missing, and its key says that it was not\n  next: bring " +
                        file_.string() + " back from a backup; to begin anew remove " + key().string()));
  std::filesystem::remove(file_);
  EXPECT_THAT(refusal(), HasSubstr("the database is empty or missing"));
  EXPECT_THAT(refusal(), HasSubstr("the database is empty or missing")) << "to refuse it must not make one";
}

TEST_F(RecordStoreTest, ADatabaseWithoutItsKeyIsRefused) {
  fill();
  std::filesystem::resize_file(key(), 31);
  EXPECT_THAT(refusal(), HasSubstr("the key of the database is missing or damaged"));
  std::filesystem::remove(key());
  EXPECT_THAT(refusal(), HasSubstr("the key of the database is missing or damaged"));
}

TEST_F(RecordStoreTest, ANewDatabaseWhoseMakerDiedBeforeTheKeyHadItsNameOpens) {
  fill();
  std::filesystem::rename(key(), key().string() + ".next");
  EXPECT_EQ(refusal(), "");
  EXPECT_TRUE(std::filesystem::exists(key()));
}

/// Of the users and of the profiles.
class DamagedRecords : public RecordStoreTest, public ::testing::WithParamInterface<const char*> {
 protected:
  std::string said_of(const std::string& damaged) {
    for (const char* ending : {"-wal", "-shm"}) std::filesystem::remove(file_.string() + ending);
    std::ofstream(file_, std::ios::binary | std::ios::trunc) << damaged;
    return damage_.in_time([&] { return refusal(&found_); });
  }
  void SetUp() override {
    kind_ = GetParam();
    fill();
    ASSERT_EQ(refusal(&whole_), "");
    std::ifstream in(file_, std::ios::binary);
    bytes_.assign(std::istreambuf_iterator<char>(in), {});
  }

  tests::Damage damage_{500};
  std::map<std::string, std::string> whole_, found_;
  std::string bytes_;
};

TEST_P(DamagedRecords, NoFlippedBitIsBelieved) {
  int refused = 0;
  for (int i = 0; i < damage_.times(); ++i) {
    if (!said_of(damage_.flipped(bytes_)).empty()) {
      ++refused;
    } else {
      EXPECT_EQ(found_, whole_);
    }
  }
  EXPECT_GT(refused, damage_.times() / 5) << "bits that carry something are most of it";
}

TEST_P(DamagedRecords, NoCutIsTakenForLess) {
  for (int i = 0; i < damage_.times(); ++i) EXPECT_NE(said_of(damage_.cut(bytes_)), "");
}

INSTANTIATE_TEST_SUITE_P(Of, DamagedRecords, ::testing::Values("users", "profiles"),
                         [](const auto& tested) { return std::string(tested.param); });

TEST_F(RecordStoreTest, AKilledProcessLosesNothingThatItWasToldIsKept) {
  RecordStore(file_, "users").put("account", "first", "1");
  std::mt19937 random(9);
  for (int round = 0; round < 10; ++round) {
    int told[2];
    ASSERT_EQ(::pipe(told), 0);
    const pid_t child = ::fork();
    if (child == 0) {
      RecordStore store(file_, "users");
      for (int i = 0;; ++i) {
        store.put("account", "r" + std::to_string(round), std::to_string(i));
        if (::write(told[1], &i, sizeof(i)) != sizeof(i)) ::_exit(1);
      }
    }
    ::close(told[1]);
    int last = -1;
    const int until = 1 + static_cast<int>(random() % 20);
    while (last < until && ::read(told[0], &last, sizeof(last)) == sizeof(last)) {
    }
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
    while (::read(told[0], &last, sizeof(last)) == sizeof(last)) {
    }
    ::close(told[0]);
    const RecordStore store(file_, "users");
    EXPECT_GE(std::stoi(store.get("account", "r" + std::to_string(round)).value_or("-1")), last);
    EXPECT_EQ(store.get("account", "first"), "1");
  }
}

TEST_F(RecordStoreTest, AFullDiskIsToldAndLosesNothing) {
  RecordStore store(file_, "users");
  store.put("account", "anna", "1");
  struct rlimit before {};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  ::signal(SIGXFSZ, SIG_IGN);
  struct rlimit small = before;
  small.rlim_cur = 64 * 1024;
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &small), 0);
  std::string refused;
  try {
    store.put("account", "bert", std::string(200'000, 'b'));
  } catch (const Error& error) {
    refused = error.what();
  }
  ::setrlimit(RLIMIT_FSIZE, &before);
  EXPECT_THAT(refused, HasSubstr("the database cannot be used: "));
  EXPECT_THAT(store.all("account"), ElementsAre(Pair("anna", "1")));
  store.put("account", "bert", "2");
  EXPECT_EQ(refusal(), "");
}

}  // namespace
}  // namespace fiona::records
