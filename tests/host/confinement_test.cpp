// What a group is told that it may reach.
#include "confinement.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>

namespace fiona::host {
namespace {

Model::Instance stranger(PluginLibraries::Files files) {
  Model::Instance one;
  auto package = std::make_shared<Package>();
  package->name = "acme/rooms";
  package->origin = Package::Origin::Unsigned;
  package->files = std::move(files);
  one.package = std::move(package);
  one.group = "cage";
  return one;
}

/// A supervisor is left what it says, in one packet (os::PacketSocket::kMaxText).
TEST(Confinement, IsSmallHoweverMuchItsLibrariesDeclare) {
  PluginLibraries::Files files;
  auto& file = *files.Add();
  file.set_path("/store/acme/rooms/lib/librooms.so");
  file.set_blake2b("b2");
  for (int i = 0; i < 10'000; ++i) file.mutable_descriptors()->add_file()->set_name("acme/rooms/" + std::to_string(i));
  const auto confinement = confinement_of(stranger(files), "/run/user/7/fiona/links", "/run/user/7/fiona/links/cage");
  ASSERT_EQ(confinement.libraries_size(), 1);
  EXPECT_EQ(confinement.libraries(0).path(), file.path());
  EXPECT_EQ(confinement.libraries(0).blake2b(), "b2");
  EXPECT_LT(confinement.ByteSizeLong(), 4096U);
}

TEST(Confinement, HidesWhereItsHostListens) {
  const auto confinement = confinement_of(stranger({}), "/run/user/7/fiona/links", "/run/user/7/fiona/links/cage");
  EXPECT_THAT(confinement.hidden(), testing::Contains("/run/user/7/fiona"));
}

}  // namespace
}  // namespace fiona::host
