// What the fuzzers begin with is read to its end: a seed that a change of the format has left behind would be refused
// at its first line, and so would a million mutations of it.
#include <gtest/gtest.h>

#include <algorithm>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/package.hpp>

#include "support.hpp"

namespace fiona::marketplace {
namespace {

using namespace testing;

std::filesystem::path seeds_of(std::string_view target) { return std::filesystem::path(FUZZ_CORPUS) / target; }

class Ignored final : public PackageSink {
 public:
  void begin(const PackageFile&) override {}
  void write(std::string_view) override {}
  void end() override {}
};

TEST(FuzzSeeds, OfPackagesHaveWholeOnesAmongThem) {
  for (const std::string name : {"package", "archive", "archive_of_messages", "archive_of_plugin"}) {
    const std::string input = file_content(seeds_of("package") / name);
    const std::string package = input.at(0) % 3 == 1 ? compress(input.substr(1)) : input.substr(1);
    std::string_view rest = package;
    const auto source = [&rest](char* buffer, std::size_t most) {
      const std::size_t count = rest.copy(buffer, std::min(most, rest.size()));
      rest.remove_prefix(count);
      return count;
    };
    Ignored sink;
    EXPECT_NO_THROW(read_package(source, "seed.fpk", sink)) << name;
  }
}

TEST(FuzzSeeds, OfAMarketplacesIndexHaveSomeThatOfferPackages) {
  for (const std::string name : {"one_package", "messages"}) {
    const Scratch scratch;
    std::filesystem::copy_file(seeds_of("marketplace_index") / name, scratch / "index.binpb");
    EXPECT_FALSE(Marketplace(scratch.path()).search({}).empty()) << name;
  }
}

TEST(FuzzSeeds, OfManifestsHaveWhatPackingAdds) {
  for (const std::string name : {"packed", "offers", "shares"}) {
    const std::string input = file_content(seeds_of("manifest") / name);
    EXPECT_NO_THROW(check_packed_manifest(parse_manifest(input.substr(1), name), name)) << name;
  }
}

}  // namespace
}  // namespace fiona::marketplace
