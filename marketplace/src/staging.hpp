#pragma once

#include <fiona/marketplace/package.hpp>
#include <set>
#include <string>

#include "durable.hpp"

namespace fiona::marketplace {

/// Writes a package's files into a new directory of a store.
class StagingSink final : public PackageSink {
 public:
  StagingSink(const DurableDirectory& store, const std::string& name);

  void begin(const PackageFile& file) override;
  void write(std::string_view bytes) override;
  void end() override;

  /// Brings the directories safely to the disk; the files are already.
  void finish();

 private:
  void make_parents(const std::string& path);

  DurableDirectory staging_;
  std::set<std::string> directories_;
  std::string path_;
  FileDescriptor file_;
};

}  // namespace fiona::marketplace
