#include "trial.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include "fiona/error.hpp"
#include "os/process.hpp"

namespace fiona::host {
namespace {

constexpr int kVerdict = 3;

std::tuple<std::uint64_t, std::uint64_t, std::int64_t> identity_of(const std::filesystem::path& library) {
  struct stat file {};
  ::stat(library.c_str(), &file);
  return {file.st_dev, file.st_ino, std::int64_t{file.st_mtim.tv_sec} * 1'000'000'000 + file.st_mtim.tv_nsec};
}

/// How opening it ended; empty: as it should.
std::string fault_of(const PluginLibraries::Files& files) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) return "";
  const os::Descriptor ours(ends[0]);
  os::Descriptor theirs(ends[1]);
  std::vector<std::string> arguments{"--try"};
  for (const auto& file : files)
    arguments.insert(arguments.end(), {file.path(), file.blake2b(), std::to_string(file.size())});
  os::ChildProcess trial(os::program_directory() / "fiona-group", arguments, {{theirs.get(), kVerdict}});
  theirs.reset();
  pollfd wait{ours.get(), POLLIN, 0};
  if (::poll(&wait, 1, static_cast<int>(Trials::kWithin.count())) <= 0) {
    return "opening it does not come to an end: a static constructor hangs";
  }
  char said[300];
  const ssize_t length = ::read(ours.get(), said, sizeof said);
  if (length > 0) return std::string(said + 1, static_cast<std::size_t>(length) - 1);
  wait = {trial.descriptor(), POLLIN, 0};
  ::poll(&wait, 1, static_cast<int>(Trials::kWithin.count()));
  return "opening it ends the process: a static constructor " + trial.end();
}

}  // namespace

void Trials::require(const std::string& plugin, const PluginLibraries::Files& files) {
  const std::filesystem::path library = files.rbegin()->path();
  const auto file = identity_of(library);
  auto known = verdicts_.find(library);
  if (known == verdicts_.end() || known->second.file != file) {
    known = verdicts_.insert_or_assign(library, Verdict{file, fault_of(files)}).first;
  }
  if (known->second.fault.empty()) return;
  throw Error(ErrorCode::Failed, {.what = "plugin '" + plugin + "' cannot be loaded: " + known->second.fault,
                                  .where = library.string(),
                                  .next = "tell the publisher"});
}

}  // namespace fiona::host
