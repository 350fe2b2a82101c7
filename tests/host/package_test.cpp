// What `load` finds is read once, for as long as somebody uses it and its files stay what they are.
#include <gtest/gtest.h>

#include <fstream>

#include "model.hpp"
#include "package.hpp"
#include "system_fixture.hpp"

namespace fiona::host {
namespace {

class PackagesOfFiles : public testing::Test {
 protected:
  PackagesOfFiles() { describe("components { name: \"nav\" }"); }
  void describe(const std::string& interface) const {
    std::ofstream(directory.path / "nav.interface.textproto") << interface;
  }
  std::shared_ptr<const Package> find() const {
    return packages.find((directory.path / "libnav.so").string() + "/nav").package;
  }

  const conformance::TemporaryDirectory directory;
  const Packages packages{directory.path / "store"};
};

TEST_F(PackagesOfFiles, AreSharedByAllInstances) {
  const auto first = find();
  EXPECT_EQ(find(), first);
}

TEST_F(PackagesOfFiles, AreReadAgainOnceTheInterfaceHasChanged) {
  const auto first = find();
  describe("components { name: \"nav\" rights: \"network\" }");
  EXPECT_EQ(find()->rights, std::vector<std::string>{"network"});
  EXPECT_TRUE(first->rights.empty());
}

TEST_F(PackagesOfFiles, AreOthersOnceTheLibraryIsAnotherBuild) {
  const auto first = find();
  std::ofstream(directory.path / "libnav.so") << "built";
  const auto second = find();
  EXPECT_NE(second, first);
  EXPECT_EQ(find(), second);
}

TEST_F(PackagesOfFiles, AreReadAgainOnceTheyHaveDataFiles) {
  const auto first = find();
  std::filesystem::create_directory(directory.path / "nav.share");
  EXPECT_EQ(find()->share, directory.path / "nav.share");
  EXPECT_TRUE(first->share.empty());
}

/// As when one version takes another's place: members are replaced one by one, the package first.
TEST_F(PackagesOfFiles, LiveAsLongAsWhatWasMadeOfTheirTypes) {
  describe(R"(
    components { name: "nav" parameters: "t.Limits" }
    descriptors { file { name: "t.proto" package: "t" message_type { name: "Limits"
      field { name: "most" number: 1 label: LABEL_OPTIONAL type: TYPE_UINT32 } } } })");
  Model::Instance served;
  served.package = find();
  served.component = "nav";
  served.parameters = served.default_parameters();
  served.package = nullptr;
  EXPECT_EQ(served.parameters->GetDescriptor()->field(0)->name(), "most");
  served = Model::Instance{};
  EXPECT_EQ(served.parameters, nullptr);
}

}  // namespace
}  // namespace fiona::host
