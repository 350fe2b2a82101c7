// What the walls of a sandbox hold, looked at from inside: a child of the test is confined and tells.
#include "os/sandbox.hpp"

#include <gtest/gtest.h>

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
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

}  // namespace
}  // namespace fiona::os
