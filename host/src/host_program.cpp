#include "host_program.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "fiona/error.hpp"

namespace fiona::host {
namespace {

/// Of what a program says before it fails.
constexpr std::size_t kMostSaid = 2000;
/// Above the numbers that a host finds its descriptors at: they are put there before the file is looked for.
constexpr int kFirstFree = 32;

}  // namespace

std::optional<HostProgram::Identity> HostProgram::identity_of(const std::filesystem::path& file) {
  struct stat is {};
  if (::stat(file.c_str(), &is) != 0) return std::nullopt;
  return Identity{is.st_dev, is.st_ino, is.st_mtim.tv_sec * 1'000'000'000 + is.st_mtim.tv_nsec};
}

/// While an installation is under way there may be none.
std::filesystem::path HostProgram::next() {
  const auto there = identity_of(path_);
  const bool same = there == held_identity_;
  on_trial_ = held_ && there && !same && there != refused_;
  if (!held_ || same || on_trial_) return path_;
  return "/proc/self/fd/" + std::to_string(held_.get());
}

void HostProgram::hold(pid_t process) {
  const std::filesystem::path running = "/proc/" + std::to_string(process) + "/exe";
  const os::Descriptor file(::open(running.c_str(), O_RDONLY | O_CLOEXEC));
  if (!file) return;  // it has ended: the one before it stays the one to go back to
  held_identity_ = identity_of(running);
  held_ = os::Descriptor(::fcntl(file.get(), F_DUPFD_CLOEXEC, kFirstFree));
  on_trial_ = false;
}

void HostProgram::refuse() {
  refused_ = identity_of(path_);
  on_trial_ = false;
}

ProgramCheck::ProgramCheck(const std::filesystem::path& program, Time now) : until_(now + kWithin) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC | O_NONBLOCK) != 0) {
    throw Error(ErrorCode::Failed, {.what = "no pipe can be made",
                                    .found = std::strerror(errno),
                                    .next = "fiona doctor; raise the limit of descriptors: ulimit -n"});
  }
  said_ = os::Descriptor(ends[0]);
  const os::Descriptor there(ends[1]);
  process_ = std::make_unique<os::ChildProcess>(
      program, std::vector<std::string>{"--version"},
      std::vector<std::pair<int, int>>{{there.get(), STDOUT_FILENO}, {there.get(), STDERR_FILENO}});
}

std::optional<std::string> ProgramCheck::verdict(Time now) {
  const std::string end = process_->end();
  if (end == "exited with code 0") return "";
  if (!end.empty()) return with_what_it_said(end);
  if (now < until_) return std::nullopt;
  process_->kill();
  return with_what_it_said("did not end within 2 s");
}

std::string ProgramCheck::with_what_it_said(std::string why) const {
  char text[kMostSaid];
  const ssize_t got = ::read(said_.get(), text, sizeof text);
  std::string said(text, got > 0 ? static_cast<std::size_t>(got) : 0);
  while (said.ends_with('\n')) said.pop_back();
  return said.empty() ? why : why + ", and said: " + said;
}

}  // namespace fiona::host
