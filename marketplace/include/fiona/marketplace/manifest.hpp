#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "fiona/manifest.pb.h"

namespace fiona::marketplace {

/// The file names that every package has; libraries are below lib/, data files below share/.
inline constexpr std::string_view kManifestFile = "manifest.textproto";
inline constexpr std::string_view kInterfaceFile = "interface.textproto";
inline constexpr std::string_view kReadmeFile = "README.md";

/// What a package may cost at most. A manifest that asks for more is refused before anything is unpacked.
struct PackageLimits {
  std::uint64_t manifest_bytes = std::uint64_t{1} << 20;
  std::uint64_t interface_bytes = std::uint64_t{512} << 10;
  std::uint64_t total_bytes = std::uint64_t{512} << 20;  ///< unpacked, all files together
  std::size_t files = 4096;
};

/// Reads a manifest and checks it as far as its author writes it: names, version, texts. `where` names the
/// file in errors. Throws fiona::Error (Failed) with line and column of what is wrong.
Manifest parse_manifest(std::string_view text, const std::string& where);

/// Reads an interface.textproto. Throws fiona::Error (Failed) with line and column of what is wrong.
Interface parse_interface(std::string_view text, const std::string& where);

/// Checks a manifest of a packed package: the author's part, and the list of files that packing adds. The
/// list holds only canonical paths, in the one order a package has, and within the limits. Throws
/// fiona::Error (Failed).
void check_packed_manifest(const Manifest& manifest, const std::string& where, const PackageLimits& limits = {});

/// Why `path` cannot be a file of a package, as the end of a sentence; empty if it can. A path is
/// interface.textproto, README.md, or below lib/ or share/; at most 100 characters; elements are ASCII
/// letters, digits and "._+@=,-", and begin with a letter, a digit or '_'.
std::string path_fault(std::string_view path);

/// Whether a package's file `a` comes before `b`: interface, README, lib/, share/; each sorted by bytes.
bool comes_before(std::string_view a, std::string_view b);

/// Of what is to be loaded the path of a library as its author builds it: of "DIR/libNAME.so" or
/// "DIR/libNAME.so/component" the former; empty where an installed package is named.
std::string_view library_path(std::string_view plugin);

/// Whether a publisher, package or component may be called so: at most 64 lower-case letters, digits and '-',
/// beginning with a letter.
bool is_name(std::string_view text);

/// Whether a publisher may be called so: a name, and none that has a meaning of its own ("local", "unsigned", the roles
/// of a marketplace).
bool is_publisher(std::string_view text);

/// Of a system package: the path of its system file in the package.
std::string system_file(const Manifest& manifest);

/// Whether it is a right that opens a part of a sandbox: "network", "device:NAME" of /dev, "read:PATH", "write:PATH",
/// "system-bus:NAME" and "session-bus:NAME" of a service on D-Bus.
bool opens_sandbox(std::string_view right);

/// Whether a service may be called so on D-Bus (D-Bus specification, "Bus names"): a well-known name, and not that of
/// the bus itself.
bool is_bus_name(std::string_view text);

/// "publisher/name".
std::string full_name(const Manifest& manifest);

/// The architecture of this build as manifests spell it: "x86_64" or "aarch64".
std::string_view this_architecture();

}  // namespace fiona::marketplace
