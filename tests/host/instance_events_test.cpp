// What instances say of themselves, on its way to the host.
#include "instance_events.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace fiona::host {
namespace {

TEST(InstanceEvents, AreReadWhateverTextAComponentPutsIntoThem) {
  std::vector<wire::GroupMessage> told;
  InstanceEvents events([&](wire::GroupMessage message) {
    wire::GroupMessage arrived;
    ASSERT_TRUE(arrived.ParseFromString(message.SerializeAsString()));
    told.push_back(std::move(arrived));
  });
  const std::string latin =
      "Stra\xdf"
      "e";
  events.mode_changed("one", "failed", latin);
  events.run_ended("one", 1, latin);
  events.logged("one", LogLevel::Info, latin);
  const std::string most(InstanceEvents::kLongestLine - 1, 'x');
  events.logged("one", LogLevel::Info, most + "\u00fc");
  ASSERT_EQ(told.size(), 4U);
  EXPECT_EQ(told[0].mode_changed().reason(), "Stra\ufffde");
  EXPECT_EQ(told[1].run_ended().reason(), "Stra\ufffde");
  EXPECT_EQ(told[2].logged().text(), "Stra\ufffde");
  EXPECT_EQ(told[3].logged().text(), most + "…") << "cut at a character";
}

}  // namespace
}  // namespace fiona::host
