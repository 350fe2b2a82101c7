#include "trial.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "fiona/error.hpp"
#include "os/limits.hpp"
#include "os/process.hpp"

namespace fiona::host {
namespace {

using Steady = std::chrono::steady_clock;

constexpr int kVerdict = 3;

constexpr const char* kHangs = "opening it does not come to an end: a static constructor hangs";

/// Of opening a library, in which this thread waits; a host that does so for longer would be taken for one that hangs.
constexpr std::chrono::seconds kLongest{8};

/// Until when a process may try that has begun then. What it has waited for a processor does not count, as in a group.
Steady::time_point end_of(pid_t process, Steady::time_point begun) {
  return begun + std::min<Steady::duration>(Trials::kWithin + os::time_waiting_for_cpu(process), kLongest);
}

bool becomes_readable(int descriptor, pid_t process, Steady::time_point begun) {
  while (true) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(end_of(process, begun) - Steady::now());
    pollfd wait{descriptor, POLLIN, 0};
    if (::poll(&wait, 1, static_cast<int>(std::max(left.count(), std::int64_t{0}))) > 0) return true;
    if (left.count() <= 0) return false;
  }
}

/// How opening it ended; empty: as it should.
std::string fault_of(const PluginLibraries::Files& files) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) {
    throw Error(ErrorCode::Failed, {.what = "a library cannot be tried before it is opened: no pipe can be made",
                                    .found = std::strerror(errno),
                                    .next = "ulimit -n gives the host more descriptors"});
  }
  const os::Descriptor ours(ends[0]);
  os::Descriptor theirs(ends[1]);
  std::vector<std::string> arguments{"--try"};
  for (const auto& file : files)
    arguments.insert(arguments.end(), {file.path(), file.blake2b(), std::to_string(file.size())});
  const auto begun = Steady::now();
  os::ChildProcess trial(os::program_directory() / "fiona-group", arguments, {{theirs.get(), kVerdict}});
  theirs.reset();
  if (!becomes_readable(ours.get(), trial.id(), begun)) return kHangs;
  char said[300];
  const ssize_t length = ::read(ours.get(), said, sizeof said);
  if (length > 0) return std::string(said + 1, static_cast<std::size_t>(length) - 1);
  if (!becomes_readable(trial.descriptor(), trial.id(), begun)) return kHangs;
  return "opening it ends the process: a static constructor " + trial.end();
}

}  // namespace

std::vector<Trials::File> Trials::identities_of(const PluginLibraries::Files& files) {
  std::vector<File> identities;
  for (const auto& file : files) {
    struct stat found {};
    ::stat(file.path().c_str(), &found);
    identities.emplace_back(file.path(), found.st_dev, found.st_ino,
                            std::int64_t{found.st_mtim.tv_sec} * 1'000'000'000 + found.st_mtim.tv_nsec);
  }
  return identities;
}

void Trials::require(const std::string& plugin, const PluginLibraries::Files& files) {
  const std::filesystem::path library = files.rbegin()->path();
  const auto tried = identities_of(files);
  const auto known = verdicts_.find(library);
  const bool holds = known != verdicts_.end() && known->second.files == tried;
  const std::string fault = holds ? known->second.fault : fault_of(files);
  // A machine that stood still looks like a library that hangs: the next who asks has it tried again.
  if (fault != kHangs) verdicts_.insert_or_assign(library, Verdict{tried, fault});
  if (fault.empty()) return;
  throw Error(ErrorCode::Failed, {.what = "plugin '" + plugin + "' cannot be loaded: " + fault,
                                  .where = library.string(),
                                  .next = "tell the publisher"});
}

}  // namespace fiona::host
