#pragma once

#include <sys/stat.h>
#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "os/process.hpp"

namespace fiona::host {

/// Which file a supervisor starts its host from: the one on the disk, where a newer build may have taken the place of
/// the one that runs; or that one, which is held open and so can be started when no name leads to it any more.
class HostProgram {
 public:
  explicit HostProgram(std::filesystem::path path) : path_(std::move(path)) {}

  /// What is to be started now.
  std::filesystem::path next();
  /// Whether that is another build than the one that is held, which may yet be needed.
  bool on_trial() const { return on_trial_; }
  /// This process has shown that its program is good: it is the one that is held from now on.
  void hold(pid_t process);
  /// The one on trial is not started again, unless its file changes or somebody asks for it.
  void refuse();
  void forget_refusal() { refused_.reset(); }
  const std::filesystem::path& path() const { return path_; }

 private:
  /// A file is another one when it was put in the place of the one before, and when it was written to.
  struct Identity {
    dev_t device = 0;
    ino_t number = 0;
    std::int64_t written_ns = 0;
    bool operator==(const Identity&) const = default;
  };
  static std::optional<Identity> identity_of(const std::filesystem::path& file);

  const std::filesystem::path path_;
  os::Descriptor held_;
  std::optional<Identity> held_identity_;
  std::optional<Identity> refused_;
  bool on_trial_ = false;
};

/// Whether a program can be started at all, without what it is there for: `PROGRAM --version` ends well, in time.
class ProgramCheck {
 public:
  using Time = std::chrono::steady_clock::time_point;
  static constexpr std::chrono::milliseconds kWithin{2000};

  /// Throws Error if it cannot be started.
  ProgramCheck(const std::filesystem::path& program, Time now);
  /// Readable when it has ended.
  int descriptor() const { return process_->descriptor(); }
  Time until() const { return until_; }
  pid_t process() const { return process_->id(); }
  /// None: not known yet. Empty: it can. Otherwise why not, with what it said.
  std::optional<std::string> verdict(Time now);

 private:
  std::string with_what_it_said(std::string why) const;

  const Time until_;
  os::Descriptor said_;
  std::unique_ptr<os::ChildProcess> process_;
};

}  // namespace fiona::host
