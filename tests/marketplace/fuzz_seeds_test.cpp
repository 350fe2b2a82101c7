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

TEST(FuzzSeeds, OfPackagesAreWholePackages) {
  for (const auto& seed : std::filesystem::directory_iterator(seeds_of("package"))) {
    const std::string input = file_content(seed.path());
    const std::string package = input.at(0) % 2 ? compress(input.substr(1)) : input.substr(1);
    std::string_view rest = package;
    const auto source = [&rest](char* buffer, std::size_t most) {
      const std::size_t count = rest.copy(buffer, std::min(most, rest.size()));
      rest.remove_prefix(count);
      return count;
    };
    Ignored sink;
    EXPECT_NO_THROW(read_package(source, "seed.fpk", sink)) << seed.path();
  }
}

TEST(FuzzSeeds, OfAMarketplacesIndexOfferPackages) {
  for (const auto& seed : std::filesystem::directory_iterator(seeds_of("marketplace_index"))) {
    const Scratch scratch;
    std::filesystem::copy_file(seed.path(), scratch / "index.binpb");
    EXPECT_FALSE(Marketplace(scratch.path()).search({}).empty()) << seed.path();
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
