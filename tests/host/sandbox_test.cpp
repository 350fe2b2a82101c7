// What the walls of a sandbox hold, looked at from inside: a child of the test is confined and tells.
#include "os/sandbox.hpp"

#include <gtest/gtest.h>

#include <fcntl.h>
#include <sched.h>
#include <sys/mount.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/sysmacros.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>

#include "../temporary_directory.hpp"
#include "os/descriptor.hpp"

namespace fiona::os {
namespace {

/// What a child of this process says, which it must do without a thread.
std::string told_by_child(const std::function<std::string()>& act) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) return "no pipe";
  const Descriptor from(ends[0]);
  Descriptor to(ends[1]);
  const pid_t child = ::fork();
  if (child == 0) {
    std::string said;
    try {
      said = act();
    } catch (const std::exception& error) {
      said = error.what();
    }
    ::_exit(::write(to.get(), said.data(), said.size()) == static_cast<ssize_t>(said.size()) ? 0 : 1);
  }
  to = Descriptor();
  std::string said;
  char piece[256];
  for (ssize_t count = 0; (count = ::read(from.get(), piece, sizeof piece)) > 0;)
    said.append(piece, static_cast<std::size_t>(count));
  int status = 0;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) ? said : "killed by signal " + std::to_string(WTERMSIG(status));
}

std::string outcome_of(long result) { return result >= 0 ? "done" : std::strerror(errno); }

/// What it does once it is confined.
std::string told_by_confined(const Reach& reach, const std::function<std::string()>& act) {
  return told_by_child([&] {
    const auto layers = confine(reach);
    const auto* const missing = missing_wall(layers);
    return missing ? missing->name + ": " + missing->missing : act();
  });
}

/// With a hole: it has no room, but for one byte.
std::string makes_long_file(const std::filesystem::path& path) {
  const Descriptor file(::open(path.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600));
  return file ? outcome_of(::pwrite(file.get(), "x", 1, 17 << 20)) : outcome_of(-1);
}

TEST(Sandbox, MakesNoFileLongerThanItsTemporaryFolder) {
  EXPECT_EQ(told_by_confined({}, [] { return makes_long_file("/tmp/long"); }), "File too large");
}

TEST(Sandbox, MakesLongFilesWhereItIsGrantedAFolder) {
  const tests::TemporaryDirectory granted;
  const auto long_file = [&granted] { return makes_long_file(granted.path / "long"); };
  EXPECT_EQ(told_by_confined({.writable = {granted.path}}, long_file), "done");
}

/// Who is root owns the machine's own nodes, and may change their rights where they can be written to as files.
TEST(Sandbox, WritesToADeviceAndDoesNotChangeItsNode) {
  const tests::TemporaryDirectory place;
  const auto node = place.path / "null";
  if (::mknod(node.c_str(), S_IFCHR | 0600, makedev(1, 3)) != 0) GTEST_SKIP() << "no device node can be made here";
  const auto change = [&node] {
    const Descriptor device(::open(node.c_str(), O_WRONLY | O_CLOEXEC));
    std::string said = outcome_of(::write(device.get(), "x", 1));
    said += "; " + outcome_of(::chmod(node.c_str(), 0));
    return said + "; " + outcome_of(::utimensat(AT_FDCWD, node.c_str(), nullptr, 0));
  };
  EXPECT_EQ(told_by_confined({.devices = {node}}, change), "done; Read-only file system; Read-only file system");
}

TEST(Sandbox, OnlyReadsTheNodesOfTheSystemsDevices) {
  const auto look = [] {
    std::string written;
    for (const std::string node : {"/dev/null", "/dev/full", "/dev/random", "/dev/urandom"}) {
      struct statvfs there {};
      if (::statvfs(node.c_str(), &there) != 0 || (there.f_flag & ST_RDONLY) == 0) written += node + " ";
    }
    return written;
  };
  EXPECT_EQ(told_by_confined({}, look), "");
}

sockaddr_un address_of(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path.string().copy(address.sun_path, sizeof address.sun_path - 1);
  return address;
}

Descriptor listen_at(const std::filesystem::path& path) {
  Descriptor listener(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  const sockaddr_un address = address_of(path);
  EXPECT_EQ(::bind(listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0) << path;
  EXPECT_EQ(::listen(listener.get(), 8), 0);  // nobody accepts
  return listener;
}

std::string connects_to(const std::filesystem::path& path) {
  const Descriptor client(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  const sockaddr_un address = address_of(path);
  return outcome_of(::connect(client.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address));
}

TEST(Sandbox, ConnectsToASocketThatItIsGranted) {
  const tests::TemporaryDirectory place;
  const auto socket = place.path / "socket";
  const Descriptor listener = listen_at(socket);
  EXPECT_EQ(told_by_confined({.devices = {socket}}, [&] { return connects_to(socket); }), "done");
}

/// As the run-time folder of its host is, whichever way it is granted what holds that.
class SandboxOfHidden : public testing::Test {
 protected:
  SandboxOfHidden() {
    std::filesystem::create_directories(folder / "own");
    listener = listen_at(folder / "socket");
    beside = listen_at(place.path / "there" / "socket");
    std::filesystem::create_directory_symlink(place.path / "there", place.path / "link");
  }
  std::string told(Reach reach, const std::function<std::string()>& act) {
    reach.hidden = {folder};
    return told_by_confined(reach, act);
  }
  const tests::TemporaryDirectory place;
  const std::filesystem::path folder = place.path / "there" / "hidden";
  Descriptor listener, beside;
};

TEST_F(SandboxOfHidden, FindsNoSocketThereBelowAFolderThatItReads) {
  const auto look = [this] { return connects_to(folder / "socket") + "; " + connects_to(folder / "../socket"); };
  EXPECT_EQ(told({.readable = {place.path / "there"}}, look), "No such file or directory; done");
  EXPECT_EQ(told({.readable = {place.path / "there/"}}, look), "No such file or directory; done");
  EXPECT_EQ(told({.writable = {place.path / "there"}}, look), "No such file or directory; done");
}

TEST_F(SandboxOfHidden, FindsNoSocketThereWhereThatIsWhatItReads) {
  const auto look = [this] { return connects_to(folder / "socket"); };
  EXPECT_EQ(told({.readable = {folder}}, look), "No such file or directory");
  EXPECT_EQ(told({.readable = {folder / ""}}, look), "No such file or directory");
}

TEST_F(SandboxOfHidden, FindsNoSocketThereOverALink) {
  const auto link = place.path / "link";
  const auto look = [&] { return connects_to(link / "hidden" / "socket") + "; " + connects_to(link / "socket"); };
  EXPECT_EQ(told({.readable = {link}}, look), "No such file or directory; done");
}

TEST_F(SandboxOfHidden, FindsWhatItIsGrantedInThereAndMakesNothingBesideIt) {
  const auto make = [this] {
    const Descriptor made(::open((folder / "file").c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600));
    const std::string said = outcome_of(made.get());
    const Descriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    const sockaddr_un address = address_of(folder / "own" / "socket");
    return said + "; " + outcome_of(::bind(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address));
  };
  const std::string said = told({.writable = {place.path / "there"}, .socket_folders = {folder / "own"}}, make);
  EXPECT_EQ(said, "Read-only file system; done");
}

/// It has made the link itself, before it was started again.
TEST(Sandbox, FindsNothingBehindALinkThatItHasMadeOfWhatItIsGranted) {
  const tests::TemporaryDirectory place, secrets;
  std::ofstream(secrets.path / "key") << "the key";
  std::filesystem::create_directory(place.path / "real");
  std::ofstream(place.path / "real" / "key") << "a map";
  std::filesystem::create_directory_symlink(secrets.path, place.path / "maps");
  const auto look = [&] {
    std::string said;
    for (const char* one : {"maps", "real"}) {
      const Descriptor file(::open((place.path / one / "key").c_str(), O_RDONLY | O_CLOEXEC));
      said += outcome_of(file.get()) + "; ";
    }
    return said;
  };
  const Reach reach{.readable = {place.path / "maps", place.path / "real"}, .writable = {place.path}};
  EXPECT_EQ(told_by_confined(reach, look), "No such file or directory; done; ");
  const Reach both{.writable = {place.path, place.path / "maps", place.path / "real"}};
  EXPECT_EQ(told_by_confined(both, look), "No such file or directory; done; ");
}

/// The mounts alone: where there is no Landlock they are all that keeps it from writing.
TEST(Sandbox, OnlyReadsWhatIsMountedBelowAFolderThatItReads) {
  if (::geteuid() != 0) GTEST_SKIP() << "only root mounts";
  const tests::TemporaryDirectory place;
  const auto below = place.path / "below";
  std::filesystem::create_directory(below);
  const auto write_below = [&]() -> std::string {
    if (::unshare(CLONE_NEWNS) != 0 || ::mount(nullptr, "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        ::mount("test", below.c_str(), "tmpfs", 0, nullptr) != 0) {
      return "no mount";
    }
    const auto file = below / "file";
    const Descriptor made(::open(file.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600));
    detail::enter_namespaces({.readable = {place.path}});
    const Descriptor read(::open(file.c_str(), O_RDONLY | O_CLOEXEC));
    const std::string said = outcome_of(read.get());
    const Descriptor written(::open(file.c_str(), O_WRONLY | O_CLOEXEC));
    return said + "; " + outcome_of(written.get());
  };
  EXPECT_EQ(told_by_child(write_below), "done; Read-only file system");
}

}  // namespace
}  // namespace fiona::os
