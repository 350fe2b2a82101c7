#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/install.hpp>
#include <set>

#include "fault_os.hpp"
#include "support.hpp"

namespace fiona::marketplace {
namespace {

using namespace testing;
namespace filesystem = std::filesystem;

// What a store holds, as a person would say it.
std::string contents(const filesystem::path& store) {
  std::string text;
  for (const auto& package : Store{store}.installed()) {
    Store{store}.verify(package);
    text += package.name() + "@" + package.manifest.version() + " ";
  }
  return text;
}

// One change of a store: what it starts from, what is done, what is there before and after.
struct Change {
  std::string name;
  std::vector<std::string> first;  // installed before
  std::string request;             // "-NAME" removes, "<" goes back
  std::string before, after;
  bool rubbish = false;  // an earlier crash left some
};

std::ostream& operator<<(std::ostream& out, const Change& change) { return out << change.name; }

class Crash : public ::testing::TestWithParam<Change> {
 protected:
  Crash() {
    publish_plugin(scratch_.path(), market_, "steps", "1.0.0", "old");
    publish_plugin(scratch_.path(), market_, "steps", "2.0.0", "new");
    publish_plugin(scratch_.path(), market_, "maps", "1.0.0");
    publish_plugin(scratch_.path(), market_, "walk", "1.0.0", "code",
                   "requirements: ['acme/maps', 'acme/steps >= 2.0.0']");
  }

  // A store in the state that the change starts from.
  filesystem::path fresh_store() {
    const filesystem::path start = scratch_ / "start", store = scratch_ / "store";
    if (!filesystem::exists(start)) {
      filesystem::create_directory(start);
      for (const auto& request : GetParam().first) install(request, Marketplace{market_}, start);
      if (GetParam().rubbish) {
        write_file(start / "staging-0123/share/a/b", "half");
        write_file(start / "packages" / std::string(64, 'a') / "lib/x.so", "old");
        write_file(start / "installed.textproto.new", "half");
      }
    }
    filesystem::remove_all(store);
    filesystem::copy(start, store, filesystem::copy_options::recursive);
    return store;
  }

  void change(const filesystem::path& store, const OsCalls& os) {
    InstallOptions options;
    options.os = os;
    const std::string& request = GetParam().request;
    if (request == "<")
      apply(plan_rollback({}, Store{store}), {}, store, options);
    else if (request.starts_with('-'))
      marketplace::remove(request.substr(1), store, options);
    else
      install(request, Marketplace{market_}, store, options);
  }

  void expect_retry_succeeds(const filesystem::path& store) {
    const bool again = GetParam().request != "<" && !GetParam().request.starts_with('-');
    if (contents(store) != GetParam().after || again) change(store, system_calls());
    EXPECT_EQ(contents(store), GetParam().after);
    install("maps", Marketplace{market_}, store);  // the next change sweeps
    for (const auto& entry : filesystem::directory_iterator(store)) {
      const std::string name = entry.path().filename();
      EXPECT_TRUE(name == "packages" || name == "generations" || name == "installed.textproto") << name << " was left";
    }
    std::set<std::string> packages;
    for (const auto& entry : filesystem::directory_iterator(store / "packages"))
      packages.insert(entry.path().filename());
    EXPECT_EQ(packages, listed(store));
  }

  // The directories that the lists of a store name.
  static std::set<std::string> listed(const filesystem::path& store) {
    std::string text = file_content(store / "installed.textproto");
    for (const auto& entry : filesystem::directory_iterator(store / "generations")) text += file_content(entry.path());
    std::set<std::string> names;
    for (std::size_t at = 0; (at = text.find("packages/", at)) != std::string::npos; at += 9)
      names.insert(text.substr(at + 9, 64));
    return names;
  }

  // The calls that change something, in the undisturbed change.
  int calls() {
    int count = 0;
    change(fresh_store(), guarded_calls([&count] { return ++count, 0; }));
    return count;
  }

  Scratch scratch_;
  filesystem::path market_ = scratch_ / "market";
};

TEST_P(Crash, KilledAtAnyCallTheStoreIsOldOrNewAndARetrySucceeds) {
  const int all = calls();
  ASSERT_GT(all, 5);
  int old_states = 0;
  for (int fatal = 1; fatal <= all; ++fatal) {
    const filesystem::path store = fresh_store();
    const pid_t child = ::fork();
    if (child == 0) {
      int count = 0;
      change(store, guarded_calls([&] { return ++count == fatal ? ::raise(SIGKILL) : 0; }));
      ::_exit(0);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) << "call " << fatal;
    const std::string found = contents(store);
    EXPECT_TRUE(found == GetParam().before || found == GetParam().after) << found << " at call " << fatal;
    old_states += found == GetParam().before;
    expect_retry_succeeds(store);
  }
  EXPECT_GT(old_states, 0);
  EXPECT_LT(old_states, all);
}

TEST_P(Crash, AnyCallThatFailsOnceIsToldAndLeavesTheOldState) {
  const int all = calls();
  for (const int error : {ENOSPC, EIO, EDQUOT, EMFILE, EROFS}) {
    for (int failing = 1; failing <= all; ++failing) {
      const filesystem::path store = fresh_store();
      int count = 0;
      std::string what;
      try {
        change(store, guarded_calls([&] { return ++count == failing ? error : 0; }));
      } catch (const Error& refused) {
        what = refused.text().what;
        EXPECT_EQ(refused.code(), ErrorCode::Failed);
        EXPECT_NE(what.find(std::strerror(error)), std::string::npos) << what;
        EXPECT_EQ(what.find("could not "), 0u) << what;
        EXPECT_FALSE(refused.text().next.empty());
      }
      // A lock that cannot be tested while sweeping only keeps rubbish longer.
      EXPECT_TRUE(!what.empty() || GetParam().rubbish) << "call " << failing << " failed and nobody said so";
      EXPECT_EQ(contents(store), what.empty() ? GetParam().after : GetParam().before)
          << "call " << failing << ": " << what;
      expect_retry_succeeds(store);
    }
  }
}

TEST_P(Crash, ADiskThatFailsFromAnyCallOnLeavesOldOrNew) {
  const int all = calls();
  for (int failing = 1; failing <= all; ++failing) {
    const filesystem::path store = fresh_store();
    int count = 0;
    EXPECT_THROW(change(store, guarded_calls([&] { return ++count >= failing ? EIO : 0; })), Error);
    const std::string found = contents(store);
    EXPECT_TRUE(found == GetParam().before || found == GetParam().after) << found << " at call " << failing;
    expect_retry_succeeds(store);
  }
}

TEST_P(Crash, ASignalAtAnyCallIsNotNoticed) {
  const int all = calls();
  for (int interrupted = 1; interrupted <= all; ++interrupted) {
    const filesystem::path store = fresh_store();
    int count = 0;
    EXPECT_NO_THROW(change(store, guarded_calls([&] { return ++count == interrupted ? EINTR : 0; })));
    EXPECT_EQ(contents(store), GetParam().after);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Changes, Crash,
    ::testing::Values(
        Change{"FirstInstall", {}, "steps@1.0.0", "", "acme/steps@1.0.0 "},
        Change{"SecondPackage", {"maps"}, "steps@1.0.0", "acme/maps@1.0.0 ", "acme/maps@1.0.0 acme/steps@1.0.0 "},
        Change{"Upgrade", {"steps@1.0.0"}, "steps", "acme/steps@1.0.0 ", "acme/steps@2.0.0 "},
        Change{"UpgradeWithRubbish", {"steps@1.0.0"}, "steps", "acme/steps@1.0.0 ", "acme/steps@2.0.0 ", true},
        Change{"Remove", {"maps", "steps@1.0.0"}, "-maps", "acme/maps@1.0.0 acme/steps@1.0.0 ", "acme/steps@1.0.0 "},
        Change{"Rollback", {"steps@1.0.0", "steps"}, "<", "acme/steps@2.0.0 ", "acme/steps@1.0.0 "},
        Change{"WithRequirement",
               {"steps@1.0.0"},
               "walk",
               "acme/steps@1.0.0 ",
               "acme/maps@1.0.0 acme/steps@2.0.0 acme/walk@1.0.0 "}),
    [](const auto& test) { return test.param.name; });

}  // namespace
}  // namespace fiona::marketplace
