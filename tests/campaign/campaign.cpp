#include "campaign.hpp"

#include <dirent.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <optional>
#include <sstream>
#include <string>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "fiona/error.hpp"
#include "fiona/result.hpp"

namespace fiona::conformance {

namespace {

/// Of a file of /proc with a "name: number" in each line, sizes in KiB.
double number_in(const std::string& path, const std::string& name) {
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with(name + ":")) return std::stod(line.substr(name.size() + 1));
  }
  throw Error(ErrorCode::NotFound, path + " has no " + name + ": the process is not there");
}

struct Process {
  char state = 0;
  pid_t parent = 0;
};

/// None: it has gone.
std::optional<Process> process_of(pid_t id) {
  std::ifstream file("/proc/" + std::to_string(id) + "/stat");
  const std::string text((std::istreambuf_iterator<char>(file)), {});
  std::istringstream rest(text.substr(std::min(text.size(), text.rfind(')') + 1)));
  Process one;
  if (!(rest >> one.state >> one.parent)) return std::nullopt;
  return one;
}

/// Those that it has started, and those that these have, but for what has ended.
std::vector<pid_t> descendants(pid_t of) {
  std::multimap<pid_t, pid_t> children;
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    const pid_t id = std::atoi(entry.path().filename().c_str());
    const auto process = id > 0 ? process_of(id) : std::nullopt;
    if (process && process->state != 'Z' && process->state != 'X') children.emplace(process->parent, id);
  }
  std::vector<pid_t> all{of};
  for (std::size_t i = 0; i < all.size(); ++i) {
    const auto [begin, end] = children.equal_range(all[i]);
    for (auto child = begin; child != end; ++child) all.push_back(child->second);
  }
  all.erase(all.begin());
  return all;
}

}  // namespace

int number_from(const char* variable, int otherwise) {
  const char* text = std::getenv(variable);
  return text && *text ? std::atoi(text) : otherwise;
}

std::vector<pid_t> processes(RunningSystem& system) {
  std::vector<pid_t> all = descendants(::getpid());
  all.push_back(::getpid());
  const auto snapshot = system.system().snapshot();
  for (const auto& group : snapshot.groups()) {
    if (group.process() == 0 || std::find(all.begin(), all.end(), group.process()) != all.end()) continue;
    throw Error(ErrorCode::NotFound, "the process of group '" + group.name() + "' is none of this system's");
  }
  return all;
}

Holdings holdings(const std::vector<pid_t>& processes) {
  constexpr double kKib = 1024;
  Holdings all;
  for (const pid_t id : processes) {
    const std::string process = "/proc/" + std::to_string(id);
    DIR* directory = ::opendir((process + "/fd").c_str());
    if (!directory) throw Error(ErrorCode::NotFound, process + " is not there, or is another user's");
    while (const dirent* entry = ::readdir(directory)) {
      ++all.descriptors;
      char target[64] = {};
      const ssize_t size = ::readlinkat(::dirfd(directory), entry->d_name, target, sizeof target - 1);
      if (size > 0 && std::string(target).starts_with("socket:")) ++all.sockets;
    }
    ::closedir(directory);
    all.threads += static_cast<long>(number_in(process + "/status", "Threads"));
    all.resident_mib += number_in(process + "/status", "RssAnon") / kKib;
    all.shared_mib += number_in(process + "/smaps_rollup", "Pss_Shmem") / kKib;
  }
  return all;
}

std::shared_ptr<google::protobuf::Message> ask(RunningSystem& system, const std::string& trigger,
                                               const std::string& arguments) {
  const auto called = system.call(trigger, arguments);
  if (called.outcome() != "ok")
    throw Error(ErrorCode::Failed, trigger + ": " + called.outcome() + ", " + called.reason());
  auto object = system.system().types().make(called.result().type());
  object->ParseFromString(called.result().object());
  return object;
}

Told::Told(const control::Sample& sample) {
  for (const auto& file : sample.files().file()) pool_.BuildFile(file);
  const auto* type = pool_.FindMessageTypeByName(sample.type());
  if (!type) throw std::runtime_error("an unknown type: " + sample.type());
  object_.reset(factory_.GetPrototype(type)->New());
  object_->ParseFromString(sample.object());
}

Sighting sighting_from(const Seen& said) {
  Sighting seen;
  seen.seen_ns = said.fixed("seen_ns");
  seen.blank_ns = said.fixed("blank_ns");
  seen.lost_ns = said.fixed("lost_ns");
  seen.last_ns = said.fixed("last_ns");
  seen.sees = said.flag("sees");
  seen.oldest_shown_ms = said.real("oldest_shown_ms");
  seen.oldest_heard_ms = said.real("oldest_heard_ms");
  seen.longest_over_ms = said.real("longest_over_ms");
  seen.heard = said.number("heard");
  seen.asked = said.number("asked");
  seen.open = said.number("open");
  seen.outcomes = said.numbers("outcomes");
  return seen;
}

Sighting sighting(RunningSystem& system, const std::string& lookout) {
  return sighting_from(*ask(system, lookout + ".testify"));
}
Sighting take_sighting(RunningSystem& system, const std::string& lookout) {
  return sighting_from(*ask(system, lookout + ".testify", "manner=forget"));
}

std::int64_t now_ns() { return Steady::now().time_since_epoch().count(); }

void let_be(RunningSystem& system, std::chrono::milliseconds time) {
  const auto end = Steady::now() + time;
  system.eventually(
      "the time passes", [end] { return Steady::now() >= end; }, time + std::chrono::seconds(10));
}

double allowed(double bound, bool in_full) { return bound * (in_full ? 1 : 3) * (FIONA_SANITIZED ? 2 : 1); }

Passing::Passing(pid_t process)
    : process_(static_cast<int>(::syscall(SYS_pidfd_open, process, 0))), watch_([this] {
        pollfd end{process_.get(), POLLIN, 0};
        if (::poll(&end, 1, 20'000) == 1) at_ns_ = now_ns();
      }) {}

double Times::longest() const { return all_.empty() ? 0 : *std::max_element(all_.begin(), all_.end()); }

std::string Times::text(const std::string& what, double bound_ms) const {
  if (all_.empty()) return what + ": none";
  auto sorted = all_;
  std::sort(sorted.begin(), sorted.end());
  const auto at = [&](std::size_t percent) {
    return sorted[std::min(sorted.size() - 1, sorted.size() * percent / 100)];
  };
  return fmt::format("{}, {} times: p50 {:.1f} ms, p99 {:.1f} ms, longest {:.1f} ms (bound {:.0f} ms)", what,
                     sorted.size(), at(50), at(99), sorted.back(), bound_ms);
}

void expect_within(const std::string& what, double bound_ms, const Times& times, bool in_full, const Pulse& pulse) {
  std::cout << times.text(what, bound_ms) << "\n";
  EXPECT_LE(times.longest(), allowed(bound_ms, in_full) + pulse.longest_ms()) << what;
}

void expect_all_answered(const Sighting& seen) {
  const auto ok = static_cast<std::size_t>(Outcome::Ok);
  ASSERT_GT(seen.outcomes.size(), ok);
  EXPECT_EQ(seen.outcomes[ok] + seen.open, seen.asked) << "answers lost by who did not die";
}

}  // namespace fiona::conformance
