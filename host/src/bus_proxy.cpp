#include "bus_proxy.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <sstream>

#include "fiona/error.hpp"
#include "os/limits.hpp"

namespace fiona::host {
namespace {

constexpr int kReady = 3;  // where it finds the pipe that says so
/// A group can make it hold whole messages, of 128 MiB at most each, and two descriptors for each of its own sockets.
constexpr std::uint64_t kMemory = 256U << 20U;
constexpr std::uint64_t kDescriptors = 4096;
constexpr int kEndsWithin_ms = 1000;

/// D-Bus specification, "Well-known Message Bus Instances": where the host itself would look.
std::string system_bus() {
  const char* const told = std::getenv("DBUS_SYSTEM_BUS_ADDRESS");
  return told && *told ? told : "unix:path=/run/dbus/system_bus_socket";
}

std::string session_bus(const std::string& group) {
  if (const char* const told = std::getenv("DBUS_SESSION_BUS_ADDRESS"); told && *told) return told;
  if (const char* const folder = std::getenv("XDG_RUNTIME_DIR"); folder && *folder)
    return fmt::format("unix:path={}/bus", folder);
  throw Error(
      ErrorCode::NotFound,
      {.what = fmt::format("group '{}' is granted services on the session's D-Bus, and there is no session", group),
       .expected = "DBUS_SESSION_BUS_ADDRESS in the host's environment",
       .next = "start the host in a session, or: dbus-run-session fiona run …"});
}

template <class Names>
void add_bus(std::vector<std::string>& arguments, const std::string& address, const std::string& socket,
             const Names& names) {
  arguments.insert(arguments.end(), {address, socket, "--filter"});
  for (const auto& name : names) arguments.push_back("--talk=" + name);
}

}  // namespace

BusProxy::BusProxy(std::string group, const wire::Confinement& confinement)
    : group_(std::move(group)), folder_(confinement.buses()), arguments_{"--fd=" + std::to_string(kReady)} {
  if (confinement.system_bus_size() > 0)
    add_bus(arguments_, system_bus(), folder_ + "/system", confinement.system_bus());
  if (confinement.session_bus_size() > 0)
    add_bus(arguments_, session_bus(group_), folder_ + "/session", confinement.session_bus());
  if (folder_.size() + std::string_view("/session").size() >= sizeof sockaddr_un::sun_path) {  // it would cut it off
    throw Error(ErrorCode::Failed,
                {.what = fmt::format("group '{}' cannot reach the services on D-Bus that it is granted", group_),
                 .expected = fmt::format("a path for its socket of at most {} bytes", sizeof sockaddr_un::sun_path - 1),
                 .found = folder_ + "/session",
                 .next = "give the group or the host a shorter name"});
  }
  std::filesystem::create_directories(folder_);
  start();
}

BusProxy::~BusProxy() {
  child_.reset();
  std::error_code ignored;
  std::filesystem::remove_all(folder_, ignored);
}

void BusProxy::start() {
  const auto program = os::program_in_path(os::kBusProxy);
  if (program.empty()) {
    throw Error(ErrorCode::NotFound,
                {.what = fmt::format("group '{}' cannot reach the services on D-Bus that it is granted: there is no {}",
                                     group_, os::kBusProxy),
                 .next = fmt::format("apt-get install {}; or load it without these rights", os::kBusProxy)});
  }
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) {
    throw Error(ErrorCode::Failed, {.what = "the system gives no pipe",
                                    .found = std::strerror(errno),
                                    .next = "raise the limit of descriptors before the host starts: ulimit -n"});
  }
  ready_ = os::Descriptor(ends[0]);
  const os::Descriptor theirs(ends[1]);
  output_ = std::make_unique<GroupOutput>();
  const int output = output_->write_end();
  child_ = std::make_unique<os::ChildProcess>(
      program, arguments_,
      std::vector<std::pair<int, int>>{{output, STDOUT_FILENO}, {output, STDERR_FILENO}, {theirs.get(), kReady}}, true);
  output_->close_write_end();
  os::limit_child(child_->id(), kMemory, kDescriptors);
}

/// Its lines without process and time, "** (process:8): WARNING **: 14:03:12.123: Failed …", each once in a row.
void BusProxy::pass_on(Time now) {
  std::istringstream lines(output_->take(now));
  for (std::string line; std::getline(lines, line);) {
    constexpr std::string_view kStars = "**: ";
    if (const auto stars = line.find(kStars); stars != std::string::npos) line.erase(0, stars + kStars.size());
    if (const auto text = line.find_first_not_of("0123456789:. "); text != 0) line.erase(0, text);
    if (line.empty() || line == told_) continue;
    std::cerr << fmt::format("group '{}': {}: {}\n", group_, os::kBusProxy, line);
    told_ = line;
  }
}

std::string BusProxy::how_it_ended() {
  pass_on(std::chrono::steady_clock::now());
  const std::string said = output_->last_lines();
  return child_->end() + (said.empty() ? "" : "; it wrote: " + said);
}

void BusProxy::require_ready(Time deadline) {
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now()).count();
  pollfd wait{ready_.get(), POLLIN, 0};
  ::poll(&wait, 1, static_cast<int>(std::max<std::int64_t>(left, 0)));
  if ((wait.revents & POLLIN) != 0) return;
  const bool ended = (wait.revents & POLLHUP) != 0;
  pollfd end{child_->descriptor(), POLLIN, 0};
  if (ended) ::poll(&end, 1, kEndsWithin_ms);  // it closes its files a moment before it can be reaped
  throw Error(ErrorCode::Failed,
              {.what = fmt::format("group '{}' cannot reach the services on D-Bus that it is granted", group_),
               .where = os::kBusProxy,
               .found = ended ? how_it_ended() : "it takes no connections",
               .next = "fiona doctor"});
}

void BusProxy::watch(Time now) {
  if (!end_.empty()) return;
  if (waits_) {
    if (supervision_.take_due(now).empty()) return;
    waits_ = false;
    try {
      start();
    } catch (const Error& error) {
      end_ = error.text().what;
    }
    return;
  }
  if (child_->end().empty()) {
    pass_on(now);
    return;
  }
  const std::string how = how_it_ended();
  waits_ = supervision_.ended(group_, now).has_value();
  if (!waits_) end_ = fmt::format("{}, its way to D-Bus, {} again and again", os::kBusProxy, how);
  if (waits_) std::cerr << fmt::format("group '{}': {} {}; it is started again\n", group_, os::kBusProxy, how);
}

}  // namespace fiona::host
