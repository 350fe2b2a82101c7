#pragma once

#include <filesystem>
#include <fiona/error.hpp>
#include <fiona/marketplace/install.hpp>
#include <fiona/marketplace/package.hpp>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::marketplace {

enum class InstallOutcome {
  Installed,         ///< it was not there before
  Replaced,          ///< another version, or other content of this version, was there: previous_version
  Repaired,          ///< it was there, its files were damaged and are now right
  AlreadyInstalled,  ///< nothing was changed: this version, or a newer one that was not asked for by number
};

struct InstallResult {
  InstallOutcome outcome;
  InstalledPackage package;
  std::string previous_version;  ///< empty if there was none
};

/// plan_install and apply of "[publisher/]name[@version]", without questions. Throws as both.
InstallResult install(std::string_view request, const Marketplace& from, const std::filesystem::path& store,
                      const InstallOptions& options = {});

/// plan_remove and apply, without questions.
InstalledPackage remove(std::string_view name, const std::filesystem::path& store, const InstallOptions& options = {});

}  // namespace fiona::marketplace

namespace fiona::marketplace::testing {

/// A directory of its own for one test, gone with it.
class Scratch {
 public:
  Scratch();
  ~Scratch();
  std::filesystem::path operator/(std::string_view name) const { return path_ / name; }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

void write_file(const std::filesystem::path& path, std::string_view content);
std::string file_content(const std::filesystem::path& path);

/// Kind, permissions and content of everything below `root`, by path: equal snapshots mean that nothing
/// changed.
std::map<std::string, std::string> snapshot(const std::filesystem::path& root);

/// The bytes of a shared object for this machine as far as packing looks, then `body`.
std::string library_bytes(std::string_view body);

/// A small plugin package with two share files, made of files below `scratch`; `more` goes into the manifest.
PackageSource plugin_source(const std::filesystem::path& scratch, const std::string& name, const std::string& version,
                            std::string_view body = "code", const std::string& more = {});

/// Puts a package into a directory that is taken as it is, without signatures. Throws as the index refuses it.
void publish(const std::filesystem::path& package, const std::filesystem::path& market, bool replace = false);

/// Packs plugin_source and publishes it into `market`.
void publish_plugin(const std::filesystem::path& scratch, const std::filesystem::path& market, const std::string& name,
                    const std::string& version, std::string_view body = "code", const std::string& more = {});

/// The error that `call` throws; fails the test if it throws none.
Error error_of(const std::function<void()>& call);

std::string compress(std::string_view bytes, int window_log = 0);
std::string decompress(std::string_view bytes);

/// A tar header (POSIX ustar) with a right checksum, whatever its fields say.
struct RawHeader {
  std::string path;
  std::uint64_t size = 0;
  char type = '0';
  std::string link{};
  unsigned mode = 0644;
};
std::string raw(const RawHeader& header);

/// Header, content and filling.
std::string raw_file(const RawHeader& header, std::string_view content);

/// The pieces of an honest package's archive, in order, each as raw_file gives it.
std::vector<std::string> pieces_of(const std::string& package);

/// Joins pieces and ends the archive.
std::string joined(const std::vector<std::string>& pieces);

}  // namespace fiona::marketplace::testing
