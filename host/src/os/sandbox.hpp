#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::os {

/// A file that a process has to itself: nobody outside can change it.
struct PrivateCopy {
  std::filesystem::path path;  ///< where it finds it
  std::uint64_t size = 0;      ///< bytes
  std::function<void(const std::filesystem::path&)> write_to;
};

/// What a process may still reach once it is confined.
struct Reach {
  std::vector<std::filesystem::path> readable{};        ///< files and folders
  std::vector<std::filesystem::path> writable{};        ///< folders
  std::vector<std::filesystem::path> socket_folders{};  ///< in which it makes sockets, and no files
  std::vector<std::filesystem::path> devices{};         ///< files, sockets included, that are opened to read and write
  std::vector<std::filesystem::path> hidden{};          ///< folders that are empty, wherever any of these holds them
  std::vector<PrivateCopy> copies{};                    ///< in folders of their own, which have nothing else
  bool network = false;
};

/// One of the walls of a sandbox, each put up by another part of the kernel.
struct SandboxLayer {
  std::string name;     ///< "mounts", "network", "processes", "landlock", "seccomp", "privileges"
  std::string detail;   ///< what it is made of here: "ABI 7", "user namespace"
  std::string missing;  ///< why it is not there; empty: it holds
};

/// [before the first thread, and before any file of others is opened] Takes from this process, for good, everything but
/// its reach, its own threads and what it has open; each layer that the kernel has. Which those are.
///
/// - mounts: a file system of its own that holds the reach and the system's libraries, nothing else
/// (mount_namespaces(7)); where nothing is writable, no file longer than its own room (RLIMIT_FSIZE)
/// - network: no interface but by right; no other process's abstract sockets (network_namespaces(7))
/// - landlock: the same for files, TCP and signals, by another part of the kernel (landlock(7))
/// - seccomp: no process, no program, no signal to others, no part of the kernel that no component needs (seccomp(2))
/// - privileges: no capability, no new ones, no look into it by others of the same user (capabilities(7), prctl(2))
std::vector<SandboxLayer> confine(const Reach& reach);

/// The first layer that is missing and without which there is no sandbox; null: it is one. The other layers are second
/// walls.
const SandboxLayer* missing_wall(const std::vector<SandboxLayer>& layers);
/// Whether there is no sandbox without this layer.
bool is_needed_layer(std::string_view name);

namespace detail {

// Each returns what the layer is made of, and throws std::system_error if the kernel does not have it.
std::string enter_namespaces(const Reach& reach);
std::string enter_own_network();
std::string restrict_by_landlock(const Reach& reach);
std::string filter_system_calls(const Reach& reach);
std::string drop_privileges();

}  // namespace detail
}  // namespace fiona::os
