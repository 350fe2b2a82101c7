#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/os_calls.hpp>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::marketplace {

/// What an author gives to make a package. Contents, not paths, where a test or a tool may have them in
/// memory.
struct PackageSource {
  std::string manifest;                          ///< manifest.textproto, fields 1 to 19 only
  std::string interface;                         ///< interface.textproto
  std::string readme;                            ///< README.md
  std::vector<std::filesystem::path> libraries;  ///< go to lib/; the first is the plugin's own
  std::filesystem::path share;                   ///< a directory whose files go to share/; empty: none
};

/// The bytes of a .fpk: equal sources give equal bytes. Throws fiona::Error (Failed) if a source is missing,
/// not allowed in a package, or above the limits.
std::string pack(const PackageSource& source, const PackageLimits& limits = {});

/// pack(), written to `file` atomically. A file that already has these bytes is left alone: returns false.
bool pack_to(const std::filesystem::path& file, const PackageSource& source, const OsCalls& os = system_calls());

/// Receives the files of a package while it is read, each as begin, write…, end; the manifest first.
/// What it has received counts for nothing until read_package returns.
class PackageSink {
 public:
  virtual ~PackageSink() = default;
  virtual void begin(const PackageFile& file) = 0;
  virtual void write(std::string_view bytes) = 0;
  virtual void end() = 0;
};

/// What reading a whole package established.
struct PackageContents {
  Manifest manifest;
  Interface interface;
  std::uint64_t size = 0;  ///< bytes of the .fpk
  std::string blake2b;     ///< of the .fpk
};

/// Fills `buffer` and returns how many bytes, 0 at the end; throws on failure.
using ByteSource = std::function<std::size_t(char* buffer, std::size_t size)>;

/// Reads a package from an untrusted source, strictly: the archive must be byte for byte the one that packing
/// these files gives (before compression), so that no two readers can disagree about it. Memory stays below
/// 64 MiB whatever the input. `where` names the package in errors. Throws fiona::Error: BadSignature if a
/// file does not match its hash, else Failed.
PackageContents read_package(const ByteSource& source, const std::string& where, PackageSink& sink,
                             const PackageLimits& limits = {});

/// Reads and checks a .fpk file and keeps nothing of it.
PackageContents inspect_package(const std::filesystem::path& file, const PackageLimits& limits = {});

}  // namespace fiona::marketplace
