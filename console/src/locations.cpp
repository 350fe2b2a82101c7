#include "locations.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>

#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/error.hpp>

namespace fiona::console {
namespace {

namespace fs = std::filesystem;

std::string environment(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

constexpr std::string_view kHostNameRule = "letters, digits, '-' and '_', at most 40";

}  // namespace

fs::path runtime_directory() {
  const std::string given = environment("XDG_RUNTIME_DIR");
  const fs::path directory =
      given.empty() ? fs::path(fmt::format("/tmp/fiona-{}", ::geteuid())) : fs::path(given) / "fiona";
  int made = 0;
  do made = ::mkdir(directory.c_str(), 0700);
  while (made != 0 && errno == EINTR);
  if (made != 0 && errno != EEXIST) {
    throw Error(ErrorCode::Failed,
                ErrorText{.what = fmt::format("the run-time directory cannot be made: {}", std::strerror(errno)),
                          .where = directory.string(),
                          .next = "set XDG_RUNTIME_DIR to a directory of yours"});
  }
  struct stat status {};
  // lstat: in a shared directory somebody else may have put a link under this name.
  const bool ours = ::lstat(directory.c_str(), &status) == 0 && S_ISDIR(status.st_mode) && status.st_uid == ::geteuid();
  if (!ours || (status.st_mode & 077U) != 0) {
    throw Error(ErrorCode::NotAllowed,
                ErrorText{.what = "the run-time directory is not yours alone",
                          .where = directory.string(),
                          .expected = fmt::format("a directory of user {} with mode 0700", ::geteuid()),
                          .found = ours ? fmt::format("mode {:04o}", status.st_mode & 07777U)
                                        : fmt::format("user {}, {}", status.st_uid,
                                                      S_ISDIR(status.st_mode) ? "a directory" : "no directory"),
                          .next = ours ? fmt::format("chmod 700 {}", directory.string())
                                       : "set XDG_RUNTIME_DIR to a directory of yours"});
  }
  return directory;
}

fs::path socket_of(std::string_view host) {
  const auto fits = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
  };
  if (host.empty() || host.size() > 40 || !std::all_of(host.begin(), host.end(), fits)) {
    throw Error(ErrorCode::Usage, ErrorText{.what = "this is no name of a host",
                                            .expected = std::string(kHostNameRule),
                                            .found = std::string(host)});
  }
  return runtime_directory() / (std::string(host) + ".sock");
}

fs::path unsigned_packages_of(const fs::path& socket) { return fs::path(socket).replace_extension(".unsigned"); }

bool answers(const fs::path& socket) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (socket.native().size() >= sizeof address.sun_path) return false;
  std::memcpy(address.sun_path, socket.c_str(), socket.native().size());
  const int descriptor = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (descriptor < 0) return false;
  const bool connected =
      ::connect(descriptor, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0 || errno == EAGAIN;
  ::close(descriptor);
  return connected;
}

std::vector<RunningHost> running_hosts() {
  std::vector<RunningHost> hosts;
  std::error_code problem;
  for (const auto& entry : fs::directory_iterator(runtime_directory(), problem)) {
    if (entry.path().extension() == ".sock" && answers(entry.path()))
      hosts.push_back({entry.path().stem().string(), entry.path()});
  }
  std::sort(hosts.begin(), hosts.end(), [](const RunningHost& a, const RunningHost& b) { return a.name < b.name; });
  return hosts;
}

namespace {

RemoteAddress remote_address(const std::string& at) {
  const std::size_t equals = at.rfind('=');
  const auto key = equals == std::string::npos ? std::nullopt : trust::Key::from_text(at.substr(equals + 1));
  if (key && trust::is_address(at.substr(0, equals))) return {at.substr(0, equals), at.substr(0, equals), *key};
  std::vector<std::string> names;
  for (const trust::KnownHost& known : trust::KeyDirectory().known()) {
    if (known.name == at || known.address == at) return {known.name, known.address, known.key};
    names.push_back(known.name);
  }
  throw Error(ErrorCode::Usage, ErrorText{.what = "this endpoint is not understood",
                                          .expected = "unix:PATH, ADDRESS:PORT=KEY, or a name that is known",
                                          .found = at,
                                          .next = "fiona keys know NAME ADDRESS:PORT KEY",
                                          .near = nearest_names(at, names)});
}

}  // namespace

Endpoint chosen_endpoint(const std::string& at, const std::string& host) {
  constexpr std::string_view kUnix = "unix:";
  if (at.starts_with(kUnix)) return {at.substr(kUnix.size())};
  if (!at.empty()) return {{}, remote_address(at)};
  const std::vector<RunningHost> hosts = running_hosts();
  std::vector<std::string> names;
  for (const RunningHost& running : hosts) names.push_back(running.name);
  if (!host.empty()) {
    const fs::path socket = socket_of(host);
    if (std::find(names.begin(), names.end(), host) != names.end()) return {socket};
    throw Error(ErrorCode::Unreachable, ErrorText{.what = fmt::format("no host '{}' runs", host),
                                                  .found = fmt::format("{}", fmt::join(names, ", ")),
                                                  .next = fmt::format("fiona run FILE --host {}", host),
                                                  .near = nearest_names(host, names)});
  }
  if (hosts.empty())
    throw Error(ErrorCode::Unreachable, ErrorText{.what = "no host runs", .next = "start one: fiona run FILE"});
  if (hosts.size() > 1) {
    throw Error(ErrorCode::Usage, ErrorText{.what = "several hosts run",
                                            .found = fmt::format("{}", fmt::join(names, ", ")),
                                            .next = fmt::format("name one: fiona --host {} …", names.front())});
  }
  return {hosts.front().socket};
}

namespace {

/// What outlives a reboot and is no configuration; empty without a home.
fs::path state_directory() {
  const std::string state = environment("XDG_STATE_HOME");
  const std::string home = environment("HOME");
  if (!state.empty()) return fs::path(state) / "fiona";
  return home.empty() ? fs::path() : fs::path(home) / ".local" / "state" / "fiona";
}

}  // namespace

fs::path history_file() {
  const fs::path directory = state_directory();
  return directory.empty() ? directory : directory / "history";
}

fs::path journal_file(const std::string& host) {
  const fs::path directory = state_directory();
  return directory.empty() ? directory : directory / (host + ".journal");
}

fs::path sibling_program(const std::string& name) {
  std::error_code problem;
  const fs::path program = fs::read_symlink("/proc/self/exe", problem).parent_path() / name;
  if (!problem && ::access(program.c_str(), X_OK) == 0) return program;
  throw Error(ErrorCode::NotFound,
              ErrorText{.what = fmt::format("the program {} is missing", name),
                        .where = program.string(),
                        .next = fmt::format("`{}` belongs beside `fiona`: build or install both", name)});
}

}  // namespace fiona::console
