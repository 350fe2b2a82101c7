#pragma once

#include <filesystem>
#include <string>

#include "fiona/wire.pb.h"
#include "os/descriptor.hpp"

namespace fiona::host {

/// A library of a package as it was installed: a copy in memory that was compared with its hash, and that nobody can
/// change any more (memfd_create(2), F_SEAL_WRITE). What happens to the file from here on does not matter.
class SealedLibrary {
 public:
  /// Throws Error: BadSignature if the file is not what was installed.
  explicit SealedLibrary(const wire::LibraryFile& file);

  /// By which this process's loader opens it. The loader goes by names, and so it may be used for one library only:
  /// none has the same while this one is open.
  std::string loader_path() const { return "/proc/self/fd/" + std::to_string(memory_.get()); }
  /// Writes it to a file that is not there yet.
  void write_to(const std::filesystem::path& path) const;

 private:
  os::Descriptor memory_;
};

}  // namespace fiona::host
