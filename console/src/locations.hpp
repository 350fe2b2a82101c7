#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::console {

/// Where the sockets of this user's hosts are: $XDG_RUNTIME_DIR/fiona, else /tmp/fiona-UID. Made if missing. Throws
/// fiona::Error (NotAllowed) unless it is a directory of this user that nobody else can enter.
std::filesystem::path runtime_directory();

/// The socket of the host of that name. Throws fiona::Error (Usage) for a name that is none.
std::filesystem::path socket_of(std::string_view host);

struct RunningHost {
  std::string name;
  std::filesystem::path socket;
};

/// The hosts of this user that take connections, by name.
std::vector<RunningHost> running_hosts();

/// Whether somebody listens on the socket.
bool answers(const std::filesystem::path& socket);

/// The socket that `at` ("unix:PATH") or `host` names, or that of the only host that runs. Throws fiona::Error:
/// Unreachable where none runs, Usage where several do, or the endpoint is of another kind.
std::filesystem::path chosen_socket(const std::string& at, const std::string& host);

/// $XDG_STATE_HOME/fiona/history, else ~/.local/state/fiona/history; empty without a home.
std::filesystem::path history_file();

/// `fiona-host` beside the running `fiona`.
std::filesystem::path host_program();

}  // namespace fiona::console
