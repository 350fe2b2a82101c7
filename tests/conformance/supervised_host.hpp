#pragma once

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <fstream>
#include <iterator>
#include <memory>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "evidence.hpp"
#include "os/process.hpp"
#include "served_host.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {

/// A host with its supervisor, as `fiona run --supervised` starts it.
class SupervisedHost {
 public:
  /// `says_to`: what is said goes there, and not into a file.
  explicit SupervisedHost(const std::vector<std::string>& arguments = {},
                          const std::filesystem::path& programs = os::program_directory(), int says_to = -1) {
    start(arguments, programs, says_to);
  }
  ~SupervisedHost() {
    lifeline_.reset();
    if (supervisor_) wait_for_end();
  }
  SupervisedHost(const SupervisedHost&) = delete;
  SupervisedHost& operator=(const SupervisedHost&) = delete;

  std::filesystem::path socket() const { return directory_.path / "private" / "kept.sock"; }
  std::filesystem::path journal() const { return directory_.path / "private" / "kept.journal"; }
  pid_t supervisor() const { return supervisor_->id(); }
  /// What the first host has said of its start.
  const std::string& said_ready() const { return said_ready_; }
  /// What was said on standard error so far.
  std::string said() const {
    std::ifstream file(directory_.path / "said");
    return {std::istreambuf_iterator<char>(file), {}};
  }
  /// The host; 0: there is none now.
  pid_t host() const {
    for (const pid_t child : children_of(supervisor())) {
      std::ifstream file("/proc/" + std::to_string(child) + "/comm");
      std::string name;
      if (std::getline(file, name) && name == "fiona-host") return child;
    }
    return 0;
  }
  /// Waits for a host, other than this one, that answers.
  std::unique_ptr<TestConsole> console(pid_t other_than = 0) const {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (std::chrono::steady_clock::now() < end) {
      if (const pid_t now = host(); now != 0 && now != other_than) {
        try {
          auto made = std::make_unique<TestConsole>(socket());
          made->snapshot();
          return made;
        } catch (const std::runtime_error&) {  // not yet, or it has ended meanwhile
        }
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    throw std::runtime_error("no host came: " + said() + evidence_of(supervisor()));
  }
  /// Ends the host, at once, and waits for the one after it.
  std::unique_ptr<TestConsole> kill_host(int signal = SIGKILL) const {
    const pid_t before = host();
    ::kill(before, signal);
    return console(before);
  }
  void let_go() { lifeline_.reset(); }
  std::string wait_for_end() {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(30);
    while (supervisor_->end().empty() && std::chrono::steady_clock::now() < end)
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    return supervisor_->end();
  }
  /// Processes, other than this one's, that have been started with this host's directory.
  std::vector<pid_t> left() const {
    std::vector<pid_t> all;
    for (const auto& one : std::filesystem::directory_iterator("/proc")) {
      const std::string name = one.path().filename();
      if (name.find_first_not_of("0123456789") != std::string::npos) continue;
      if (content_of(one.path() / "cmdline").find(directory_.path.string()) != std::string::npos)
        all.push_back(std::stoi(name));
    }
    return all;
  }
  static std::vector<pid_t> children_of(pid_t process) {
    const std::string id = std::to_string(process);
    std::ifstream file("/proc/" + id + "/task/" + id + "/children");
    return {std::istream_iterator<pid_t>(file), {}};
  }

 private:
  void start(const std::vector<std::string>& given, const std::filesystem::path& programs, int says_to) {
    std::filesystem::create_directory(directory_.path / "private");
    std::filesystem::permissions(directory_.path / "private", std::filesystem::perms::owner_all);
    std::array<int, 2> ready{}, lifeline{};
    if (::pipe2(ready.data(), O_CLOEXEC) != 0 || ::pipe2(lifeline.data(), O_CLOEXEC) != 0)
      throw std::runtime_error("no pipe");
    const os::Descriptor ready_here(ready[0]);
    os::Descriptor ready_there(ready[1]);
    const os::Descriptor lifeline_there(lifeline[0]);
    lifeline_ = os::Descriptor(lifeline[1]);
    const os::Descriptor said(
        ::open((directory_.path / "said").c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600));
    std::vector<std::string> arguments{
        "--ready-fd", "3",        "--lifeline-fd",   "4",       "--name",
        "kept",       "--socket", socket().string(), "--store", (directory_.path / "store").string(),
        "--threads",  "2"};
    arguments.insert(arguments.end(), given.begin(), given.end());
    supervisor_ = std::make_unique<os::ChildProcess>(
        programs / "fiona-supervisor", arguments,
        std::vector<std::pair<int, int>>{{ready_there.get(), 3},
                                         {lifeline_there.get(), 4},
                                         {says_to < 0 ? said.get() : says_to, STDOUT_FILENO},
                                         {says_to < 0 ? said.get() : says_to, STDERR_FILENO}});
    ready_there.reset();
    char text[4096];
    for (ssize_t got = 0; (got = ::read(ready_here.get(), text, sizeof text)) > 0;)
      said_ready_.append(text, static_cast<std::size_t>(got));
  }

  const TemporaryDirectory directory_;
  os::Descriptor lifeline_;
  std::string said_ready_;
  std::unique_ptr<os::ChildProcess> supervisor_;
};

}  // namespace fiona::conformance
