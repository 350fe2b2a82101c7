#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "remote_link.hpp"

namespace fiona::console {

/// Where the sockets of this user's hosts are: $XDG_RUNTIME_DIR/fiona, else /tmp/fiona-UID. Made if missing. Throws
/// fiona::Error (NotAllowed) unless it is a directory of this user that nobody else can enter.
std::filesystem::path runtime_directory();

/// The socket of the host of that name. Throws fiona::Error (Usage) for a name that is none.
std::filesystem::path socket_of(std::string_view host);

/// The store of the packages that a host was started with though nobody has signed them, beside its socket.
std::filesystem::path unsigned_packages_of(const std::filesystem::path& socket);

struct RunningHost {
  std::string name;
  std::filesystem::path socket;
};

/// The hosts of this user that take connections, by name.
std::vector<RunningHost> running_hosts();

/// Whether somebody listens on the socket.
bool answers(const std::filesystem::path& socket);

/// Where a host is: behind a socket of this machine, or over tcp.
struct Endpoint {
  std::filesystem::path socket{};
  std::optional<RemoteAddress> remote{};
  /// "unix:PATH", "tcp://ADDRESS:PORT".
  std::string text() const { return remote ? "tcp://" + remote->address : "unix:" + socket.string(); }
};

/// What `at` ("unix:PATH", "ADDRESS:PORT=KEY", a name of `keys know`) or `host` names, or the only host that runs.
/// Throws fiona::Error: Unreachable where none runs, Usage where several do, or the endpoint is of another kind.
Endpoint chosen_endpoint(const std::string& at, const std::string& host);

/// $XDG_STATE_HOME/fiona/history, else ~/.local/state/fiona/history; empty without a home.
std::filesystem::path history_file();

/// $XDG_STATE_HOME/fiona/HOST.journal, else below ~/.local/state: a reboot leaves it. Empty without a home.
std::filesystem::path journal_file(const std::string& host);

/// The program of that name beside the running `fiona`. Throws fiona::Error (NotFound).
std::filesystem::path sibling_program(const std::string& name);

}  // namespace fiona::console
