// That a journal reaches the disk: what a power cut would leave of it. Syncs and renames are noted in the place of the
// C library's.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <stdio.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>

#include "engine.hpp"
#include "fiona/error.hpp"
#include "mailbox.hpp"
#include "system_fixture.hpp"

namespace {

/// Of all files, by their number: how many bytes have been synced, and who has taken a name with bytes that were not;
/// and folders that have not been synced since a name was given there.
struct Disk {
  std::mutex mutex;
  std::map<ino_t, off_t> synced_bytes;
  std::set<std::string> named_before_synced;
  std::set<ino_t> unsynced_folders;

  bool has_all_of(const struct stat& file) {
    const auto found = synced_bytes.find(file.st_ino);
    return found != synced_bytes.end() && found->second >= file.st_size;
  }
};
Disk disk;

}  // namespace

extern "C" int fdatasync(int file) {
  struct stat before {};
  const bool known = ::fstat(file, &before) == 0;
  const int result = static_cast<int>(::syscall(SYS_fdatasync, file));
  const std::lock_guard lock(disk.mutex);
  if (known && result == 0) disk.synced_bytes[before.st_ino] = before.st_size;
  return result;
}

extern "C" int fsync(int file) {
  struct stat synced {};
  const bool known = ::fstat(file, &synced) == 0;
  const int result = static_cast<int>(::syscall(SYS_fsync, file));
  const std::lock_guard lock(disk.mutex);
  if (known && result == 0) disk.unsynced_folders.erase(synced.st_ino);
  return result;
}

extern "C" int rename(const char* from, const char* to) {
  struct stat file {
  }, folder{};
  {
    const std::lock_guard lock(disk.mutex);
    if (::stat(from, &file) == 0 && !disk.has_all_of(file)) disk.named_before_synced.insert(to);
    const auto parent = std::filesystem::path(to).parent_path();
    if (::stat(parent.c_str(), &folder) == 0) disk.unsynced_folders.insert(folder.st_ino);
  }
  return ::renameat(AT_FDCWD, from, AT_FDCWD, to);
}

namespace fiona::host {
namespace {

class JournalOnDisk : public testing::Test {
 protected:
  JournalOnDisk() {
    const std::lock_guard lock(disk.mutex);
    disk.synced_bytes.clear();
    disk.named_before_synced.clear();
    disk.unsynced_folders.clear();
  }
  static bool is_whole(const std::filesystem::path& file) {
    struct stat now {};
    const std::lock_guard lock(disk.mutex);
    return ::stat(file.c_str(), &now) == 0 && disk.has_all_of(now);
  }
  /// Else the one before it comes back.
  static bool has_its_name(const std::filesystem::path& file) {
    struct stat folder {};
    const std::lock_guard lock(disk.mutex);
    return ::stat(file.parent_path().c_str(), &folder) == 0 && !disk.unsynced_folders.contains(folder.st_ino);
  }
  static bool was_whole_when_named(const std::filesystem::path& file) {
    const std::lock_guard lock(disk.mutex);
    return !disk.named_before_synced.contains(file);
  }
  /// What it tells whom the power comes back to.
  Journal::Told after_power_cut() const {
    std::ifstream stream(file, std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
    struct stat now {};
    ::stat(file.c_str(), &now);
    const std::lock_guard lock(disk.mutex);
    return Journal::told_by(std::string_view(bytes).substr(0, static_cast<std::size_t>(disk.synced_bytes[now.st_ino])));
  }
  static control::JournalEntry with_comment(std::size_t bytes) {
    control::JournalEntry entry;
    entry.add_steps()->mutable_load()->set_comment(std::string(bytes, 'x'));
    return entry;
  }

  conformance::TemporaryDirectory directory;
  const std::filesystem::path file = directory.path / "journal";
};

TEST_F(JournalOnDisk, HasEachChangeThatWasAnswered) {
  Mailbox<std::function<void()>> work;
  conformance::RunningSystem system;
  Engine engine(system.system(), file, [&work](std::function<void()> job) { work.push(std::move(job)); });
  for (int change = 1; change <= 3; ++change) {
    control::Transact request;
    control::Load& load = *request.add_changes()->mutable_load();
    load.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/source");
    load.set_instance("source" + std::to_string(change));
    control::Reply answered;
    engine.transact("test", request, [&answered](const control::Reply& reply) { answered = reply; });
    system.eventually("the answer", [&] {
      for (const auto& job : work.take()) job();
      return answered.has_done() || answered.has_failure();
    });
    ASSERT_TRUE(answered.has_done()) << answered.failure().what();
    system.eventually("it is synced", [&] { return is_whole(file); });
    const auto told = after_power_cut();
    EXPECT_EQ(told.damaged, 0U);
    ASSERT_EQ(told.changes.size(), static_cast<std::size_t>(change));
    EXPECT_EQ(told.changes.back().load().instance(), "source" + std::to_string(change));
  }
}

TEST_F(JournalOnDisk, TellsWhatItHadNoRoomForOnceThereIsSome) {
  Journal journal(file);
  const auto number = journal.begin(with_comment(10));
  struct rlimit before {};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  struct rlimit none = before;
  none.rlim_cur = std::filesystem::file_size(file);
  const auto handler = ::signal(SIGXFSZ, SIG_IGN);
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &none), 0);
  EXPECT_THROW(journal.end(number, control::JournalEntry::DONE, "", nullptr), Error);
  EXPECT_THROW(journal.begin(with_comment(10)), Error);
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &before), 0);
  ::signal(SIGXFSZ, handler);
  journal.end(journal.begin(with_comment(20)), control::JournalEntry::DONE, "", nullptr);
  const auto told = Journal::read(file);
  EXPECT_EQ(told.damaged, 0U);
  ASSERT_EQ(told.changes.size(), 2U);
  EXPECT_EQ(told.changes[0].load().comment().size(), 10U);
}

TEST_F(JournalOnDisk, HasTheLastRecordAtItsEnd) {
  // One behind the other: behind the first the syncer rests for a while.
  for (int records = 1; records <= 20; ++records) {
    {
      Journal journal(file);
      for (int i = 0; i < records; ++i) {
        const auto number = journal.begin(with_comment(10));
        journal.end(number, control::JournalEntry::DONE, "", nullptr);
      }
    }
    ASSERT_TRUE(is_whole(file)) << records << " records";
    EXPECT_EQ(after_power_cut().changes.size(), static_cast<std::size_t>(records));
  }
}

TEST_F(JournalOnDisk, IsThereBeforeItTakesTheNameOfTheOneBeforeItForGood) {
  constexpr std::size_t kLarge = 1'500'000;  // three of which are folded
  const Model none;
  {
    Journal journal(file);
    for (int i = 0; i < 4; ++i) {
      const auto number = journal.begin(with_comment(kLarge));
      journal.end(number, control::JournalEntry::DONE, "", &none);
    }
    EXPECT_LT(std::filesystem::file_size(file), 3 * kLarge) << "it was folded";
  }
  EXPECT_TRUE(was_whole_when_named(file));
  EXPECT_TRUE(has_its_name(file));
  const Journal next(file, Journal::read(file));
  EXPECT_TRUE(was_whole_when_named(file));
  EXPECT_TRUE(has_its_name(file));
}

}  // namespace
}  // namespace fiona::host
