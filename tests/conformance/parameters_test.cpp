// Parameters (docs/patterns.md). They are the same whichever process the component is in.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "fiona/error.hpp"
#include "system_fixture.hpp"

namespace fiona::conformance {
namespace {

using testing::HasSubstr;

class Parameter : public OverTransports {
 protected:
  void SetUp() override { system.load_client("clerk", "clerk"); }

  std::string value(const std::string& name) {
    const auto instance = system.instance("clerk");
    for (const auto& one : instance.parameters()) {
      if (one.name() == name) return one.value();
    }
    return "none";
  }
  std::string refusal_of(const std::string& parameters) {
    try {
      system.set("clerk", parameters);
    } catch (const Error& error) {
      return error.text().what;
    }
    return "";
  }
};

TEST_P(Parameter, FieldsCarryDefaultRangeUnitEnumeratorsAndDoc) {
  const auto instance = system.instance("clerk");
  const auto& low = instance.parameters(0);
  EXPECT_EQ(low.name(), "low");
  EXPECT_EQ(low.default_value(), "1");
  EXPECT_EQ(low.unit(), "m");
  EXPECT_EQ(low.range(), "0 .. 100, in steps of 0.5");
  EXPECT_EQ(low.doc(), "below high");
  const auto& pace = instance.parameters(3);
  EXPECT_THAT(pace.range(), HasSubstr("RUN"));
}

TEST_P(Parameter, ChangeOfSeveralFieldsIsMadeTogetherAndToldOnce) {
  system.set("clerk", "low=3 high=5 width=2 pace=RUN");
  EXPECT_EQ(value("low") + " " + value("high") + " " + value("width"), "3 5 2");
  EXPECT_THAT(value("pace"), HasSubstr("RUN"));
  EXPECT_EQ(system.read("clerk.changes").value(), 1);
}

TEST_P(Parameter, OneWrongFieldAmongSeveralChangesNone) {
  EXPECT_THAT(refusal_of("low=3 high=5 width=200"), HasSubstr("width is 200, above 100"));
  EXPECT_EQ(value("low") + " " + value("high") + " " + value("width"), "1 2 1");
  EXPECT_FALSE(system.read("clerk.changes").has_value);
}

TEST_P(Parameter, DeclaredRulesComeBeforeTheComponentsOwnCheck) {
  EXPECT_THAT(refusal_of("low=101"), HasSubstr("low is 101, above 100")) << "though the width is wrong then, too";
  EXPECT_THAT(refusal_of("low=0.5"), HasSubstr("width is not what is between low and high"));
}

TEST_P(Parameter, RefusalLeavesNothingBehindThatSpoilsTheNextChange) {
  EXPECT_NE(refusal_of("low=0.5"), "");
  EXPECT_EQ(refusal_of("high=3 width=2"), "");
  EXPECT_EQ(value("low") + " " + value("high") + " " + value("width"), "1 3 2");
}

TEST_P(Parameter, TasksSeeOneConsistentSnapshot) {
  for (int i = 0; i < 200; ++i) system.set("clerk", i % 2 == 0 ? "high=3 width=2" : "high=2 width=1");
  system.eventually("it looks", [&] { return system.read("clerk.looks").value() > 50; });
  EXPECT_FALSE(system.read("clerk.torn").has_value);
}

FIONA_OVER_EVERY_TRANSPORT(Parameter);

}  // namespace
}  // namespace fiona::conformance
