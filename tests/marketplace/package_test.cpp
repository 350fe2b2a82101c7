#include <gtest/gtest.h>
#include <sys/stat.h>

#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/package.hpp>
#include <fiona/plugin.hpp>

#include "support.hpp"

namespace fiona::marketplace {
namespace {

using namespace testing;

class Collected final : public PackageSink {
 public:
  void begin(const PackageFile& file) override { files.emplace_back(file.path(), ""); }
  void write(std::string_view bytes) override { files.back().second += bytes; }
  void end() override {}
  std::vector<std::pair<std::string, std::string>> files;
};

PackageContents read(std::string_view bytes, PackageSink& sink, std::size_t piece = 1 << 16) {
  const auto source = [&](char* buffer, std::size_t size) {
    const std::size_t count = std::min({size, piece, bytes.size()});
    bytes.copy(buffer, count);
    bytes.remove_prefix(count);
    return count;
  };
  return read_package(source, "test.fpk", sink);
}

TEST(Blake2b, TheEmptyInputHashesToThePublishedValue) {
  EXPECT_EQ(blake2b(""), "0e5751c026e543b2e8ab2eb06099daa1d1e5df47778f7787faab45cdf12fe3a8");
}

TEST(Package, WhatWasPackedIsReadInTheFixedOrder) {
  const Scratch scratch;
  Collected sink;
  const PackageContents contents = read(pack(plugin_source(scratch.path(), "steps", "1.0.0")), sink);
  std::vector<std::string> order;
  for (const auto& [path, content] : sink.files) order.push_back(path);
  EXPECT_EQ(order, (std::vector<std::string>{"manifest.textproto", "interface.textproto", "README.md",
                                             "lib/libsteps.so", "share/data/map.osm", "share/help.txt"}));
  EXPECT_EQ(sink.files[3].second, library_bytes("code"));
  EXPECT_EQ(contents.manifest.library(), "lib/libsteps.so");
  EXPECT_EQ(contents.manifest.architecture(), this_architecture());
  EXPECT_EQ(contents.manifest.abi(), kAbiTag);
  EXPECT_EQ(contents.interface.components(0).name(), "steps");
}

TEST(Package, TheSameSourcesGiveTheSameBytes) {
  const Scratch scratch, other;
  const std::string first = pack(plugin_source(scratch.path(), "steps", "1.0.0"));
  const PackageSource again = plugin_source(other.path(), "steps", "1.0.0");
  ::chmod((other.path() / "source-steps-1.0.0/share/help.txt").c_str(), 0600);
  EXPECT_EQ(blake2b(pack(again)), blake2b(first));
}

TEST(Package, ItCanBeReadInPiecesOfAnySize) {
  const Scratch scratch;
  std::string noise;
  for (unsigned i = 0, x = 1; i < 200'000; ++i) noise += static_cast<char>((x = x * 1664525 + 1013904223) >> 24);
  const std::string package = pack(plugin_source(scratch.path(), "steps", "1.0.0", noise));
  for (const std::size_t piece : {1, 511, 4096}) {
    Collected sink;
    EXPECT_EQ(read(package, sink, piece).blake2b, blake2b(package));
    EXPECT_EQ(sink.files[3].second, library_bytes(noise));
  }
}

// The comparison with the canonical archive must not depend on where the decompressor's blocks end.
TEST(Package, FilesOfEverySizeAroundABlockAreRead) {
  const Scratch scratch;
  for (const std::size_t size : {0, 1, 447, 448, 449, 512, 65'000, 65'472, 65'536, 131'072}) {
    Collected sink;
    const auto source = plugin_source(scratch.path(), "steps", "1.0.0", std::string(size, 'x'));
    EXPECT_NO_THROW(read(pack(source), sink)) << size;
    EXPECT_EQ(sink.files[3].second.size(), library_bytes("").size() + size);
  }
}

TEST(Package, PackingTwiceLeavesTheFileAlone) {
  const Scratch scratch;
  const auto source = plugin_source(scratch.path(), "steps", "1.0.0");
  EXPECT_TRUE(pack_to(scratch / "out.fpk", source));
  EXPECT_FALSE(pack_to(scratch / "out.fpk", source));
}

TEST(Package, AManifestThatSaysWhatPackingWritesIsRefused) {
  const Scratch scratch;
  auto source = plugin_source(scratch.path(), "steps", "1.0.0");
  source.manifest += " library: 'lib/x.so'";
  EXPECT_STREQ(error_of([&] { pack(source); }).what(),
               "manifest.textproto: library, architecture, abi, files, offered and shared are written by packing\n"
               "  next: take them out of the manifest");
}

TEST(Package, ARightThatTheCodeUsesMustStandInTheManifest) {
  const Scratch scratch;
  auto source = plugin_source(scratch.path(), "steps", "1.0.0");
  source.interface.insert(source.interface.find(" ports"), " rights: 'master'");
  EXPECT_STREQ(error_of([&] { pack(source); }).what(),
               "manifest.textproto: component 'steps' uses the right 'master', and the manifest does not ask for it\n"
               "  expected: rights: \"master\"\n"
               "  next: correct it and pack again");
  source.manifest += " rights: 'master'";
  EXPECT_NO_THROW(pack(source));
}

TEST(Package, APluginNeedsALibrary) {
  const Scratch scratch;
  auto source = plugin_source(scratch.path(), "steps", "1.0.0");
  source.libraries.clear();
  EXPECT_EQ(error_of([&] { pack(source); }).text().what, "a package of this kind needs a library");
}

TEST(Package, AScriptIsNoLibrary) {
  const Scratch scratch;
  auto source = plugin_source(scratch.path(), "steps", "1.0.0");
  write_file(source.libraries[0], "#!/bin/sh\n");
  EXPECT_EQ(error_of([&] { pack(source); }).text().what,
            "this is not a shared library of an architecture that packages are made for");
}

TEST(Package, ALinkAmongTheDataFilesIsRefusedAtPacking) {
  const Scratch scratch;
  const auto source = plugin_source(scratch.path(), "steps", "1.0.0");
  std::filesystem::create_symlink("/etc/hosts", source.share / "hosts");
  EXPECT_EQ(error_of([&] { pack(source); }).text().what, "a package holds no links");
}

TEST(Package, APlannedInterfaceIsNotPacked) {
  const Scratch scratch;
  auto source = plugin_source(scratch.path(), "steps", "1.0.0");
  source.interface += " planned: true";
  EXPECT_EQ(error_of([&] { pack(source); }).text().what, "a planned interface has nothing to pack");
}

TEST(Package, ADataPackageHasNoLibrary) {
  const Scratch scratch;
  auto source = plugin_source(scratch.path(), "maps", "1.0.0");
  source.manifest += " kind: DATA";
  source.libraries.clear();
  Collected sink;
  EXPECT_EQ(read(pack(source), sink).manifest.architecture(), "");
}

TEST(Package, AMissingFileIsNotFound) {
  const Error error = error_of([] { inspect_package("no-such.fpk"); });
  EXPECT_EQ(error.code(), ErrorCode::NotFound);
  EXPECT_STREQ(error.what(),
               "no-such.fpk: there is no such package file\n  next: look at the path, or pack the package first");
}

}  // namespace
}  // namespace fiona::marketplace
