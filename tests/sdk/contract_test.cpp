// Contracts, rules, parameters, units, names: what is decided on values alone.
#include <gmock/gmock.h>
#include <google/protobuf/descriptor.pb.h>
#include <google/protobuf/dynamic_message.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <deque>
#include <limits>
#include <memory>
#include <string>

#include "fiona/contract.hpp"
#include "fiona/master.hpp"
#include "fiona/message.hpp"
#include "fiona/params.hpp"
#include "fiona/readable_text.hpp"
#include "fiona/rules.hpp"
#include "fiona/sdk_test/objects.fiona.hpp"
#include "fiona/testing/inline_executor.hpp"
#include "fiona/units.hpp"
#include "support.hpp"

namespace fiona::sdk_test {
namespace {

using google::protobuf::DescriptorPool;
using google::protobuf::FieldDescriptorProto;
using google::protobuf::FileDescriptorProto;
using google::protobuf::ServiceDescriptor;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::ThrowsMessage;

// ---- text -----------------------------------------------------------------------------------------------------

TEST(ReadableText, IsUtf8WhateverItIsMadeOf) {
  EXPECT_EQ(readable_text("Stra\u00dfe \u20ac \U0001f600"), "Stra\u00dfe \u20ac \U0001f600");
  EXPECT_EQ(readable_text(""), "");
  EXPECT_EQ(readable_text("Stra\xdf"
                          "e"),
            "Stra\ufffde")
      << "Latin-1";
  EXPECT_EQ(readable_text("\xc3"), "\ufffd") << "the first half of a character";
  EXPECT_EQ(readable_text("\xc0\xaf"), "\ufffd\ufffd") << "longer than it need be";
  EXPECT_EQ(readable_text("\xe0\x80\xaf"), "\ufffd\ufffd\ufffd");
  EXPECT_EQ(readable_text("\xed\xa0\x80"), "\ufffd\ufffd\ufffd") << "half of a pair";
  EXPECT_EQ(readable_text("\xf4\x90\x80\x80"), "\ufffd\ufffd\ufffd\ufffd") << "above all characters";
  EXPECT_EQ(readable_text("a\xe2\x82z"), "a\ufffd\ufffdz");
  std::string bytes;
  for (int first = 0; first < 256; ++first) {
    for (int second = 0; second < 256; ++second) bytes += {static_cast<char>(first), static_cast<char>(second)};
  }
  Ruled one;
  one.set_name(readable_text(bytes));
  EXPECT_TRUE(Ruled().ParseFromString(one.SerializeAsString()));
}

TEST(ReadableText, EndsAtACharacter) {
  EXPECT_EQ(readable_text("x\u00fc\u00fc", 4), "x\u00fc");
  EXPECT_EQ(readable_text("x\u00fc\u00fc", 5), "x\u00fc\u00fc");
  EXPECT_EQ(readable_text("\xff\xff", 5), "\ufffd");
  EXPECT_EQ(readable_text("\u00fc", 1), "");
}

// ---- contracts ------------------------------------------------------------------------------------------------

/// The test's proto file as another package might have it.
class OtherContract : public ::testing::Test {
 protected:
  OtherContract() { Ruled::descriptor()->file()->CopyTo(&file); }

  FieldDescriptorProto& field(const std::string& name) {
    for (auto& message : *file.mutable_message_type()) {
      for (auto& one : *message.mutable_field()) {
        if (message.name() == "Ruled" && one.name() == name) return one;
      }
    }
    throw std::runtime_error("no field " + name);
  }
  ServiceContract& contract_of_file() {
    for (auto& service : *file.mutable_service()) {
      if (service.name() == "RuledObjects") return *service.mutable_options()->MutableExtension(contract);
    }
    throw std::runtime_error("no service");
  }
  const ServiceDescriptor& other(const std::string& service = "RuledObjects") {
    auto& pool = pools.emplace_back(DescriptorPool::generated_pool());
    if (!pool.BuildFile(file)) throw std::runtime_error("the changed file does not build");
    return *pool.FindServiceByName("fiona.sdk_test." + service);
  }
  const ServiceDescriptor& ours() { return RuledObjects::info().descriptor(); }

  FileDescriptorProto file;
  std::deque<DescriptorPool> pools;
};

TEST_F(OtherContract, LeaseIsWhatItSaysOrThreePeriodsAndAtLeast300Ms) {
  const auto lease_of = [this](std::uint32_t lease_ms, std::uint32_t period_ms) {
    contract_of_file().set_lease_ms(lease_ms);
    contract_of_file().set_period_ms(period_ms);
    return std::chrono::duration_cast<std::chrono::milliseconds>(ServiceInfo(other()).lease()).count();
  };
  EXPECT_EQ(lease_of(0, 0), 0) << "none";
  EXPECT_EQ(lease_of(100, 0), 100);
  EXPECT_EQ(lease_of(100, 1000), 100);
  EXPECT_EQ(lease_of(0, 1000), 3000);
  EXPECT_EQ(lease_of(0, 101), 303);
  EXPECT_EQ(lease_of(0, 100), 300);
  EXPECT_EQ(lease_of(0, 20), 300);
}

TEST_F(OtherContract, SameFileFromAnotherPoolFits) { EXPECT_EQ(contract_difference(ours(), other()), std::nullopt); }

TEST_F(OtherContract, OtherUnitIsNamed) {
  field("length").mutable_options()->SetExtension(unit, "km");
  EXPECT_EQ(contract_difference(ours(), other()),
            "field fiona.sdk_test.Ruled.length has unit 'm' required, 'km' provided");
}

TEST_F(OtherContract, OtherFrameIsNamed) {
  field("length").mutable_options()->SetExtension(frame, "body");
  EXPECT_EQ(contract_difference(ours(), other()),
            "field fiona.sdk_test.Ruled.length has frame 'enu' required, 'body' provided");
}

TEST_F(OtherContract, OtherArrayLengthIsNamed) {
  field("triple").mutable_options()->SetExtension(size, 4);
  EXPECT_EQ(contract_difference(ours(), other()),
            "field fiona.sdk_test.Ruled.triple has size '3' required, '4' provided");
}

TEST_F(OtherContract, OtherTypeIsNamedEvenWhereTheWireTypeIsTheSame) {
  field("name").set_type(FieldDescriptorProto::TYPE_BYTES);
  EXPECT_EQ(contract_difference(ours(), other()),
            "field fiona.sdk_test.Ruled.name has type 'string' required, 'bytes' provided");
}

TEST_F(OtherContract, OtherCardinalityIsNamed) {
  field("anything").set_label(FieldDescriptorProto::LABEL_REPEATED);
  EXPECT_EQ(contract_difference(ours(), other()),
            "field fiona.sdk_test.Ruled.anything has cardinality 'singular' required, 'repeated' provided");
}

TEST_F(OtherContract, OtherEnumeratorNumberIsNamed) {
  file.mutable_enum_type(0)->mutable_value(1)->set_number(7);
  EXPECT_EQ(contract_difference(ours(), other()),
            "field fiona.sdk_test.Ruled.colour has enumerator GREEN '1' required, '7' provided");
}

TEST_F(OtherContract, DifferenceInANestedObjectIsFound) {
  for (auto& message : *file.mutable_message_type()) {
    if (message.name() == "Inner") message.mutable_field(0)->mutable_options()->SetExtension(unit, "deg");
  }
  EXPECT_EQ(contract_difference(ours(), other()),
            "field fiona.sdk_test.Inner.angle has unit 'rad' required, 'deg' provided");
}

TEST_F(OtherContract, FieldThatOnlyOneSideHasIsHowAMinorVersionGrows) {
  auto& added = *file.mutable_message_type(2)->add_field();
  ASSERT_EQ(file.message_type(2).name(), "Ruled");
  added.set_name("added");
  added.set_number(20);
  added.set_label(FieldDescriptorProto::LABEL_OPTIONAL);
  added.set_type(FieldDescriptorProto::TYPE_DOUBLE);
  EXPECT_EQ(contract_difference(ours(), other()), std::nullopt);
  EXPECT_EQ(contract_difference(pools.back().FindServiceByName("fiona.sdk_test.RuledObjects")[0], ours()),
            std::nullopt);
}

TEST_F(OtherContract, ProvidersMinorMayBeAboveTheClientsButNotBelow) {
  contract_of_file().set_minor(1);
  const auto& newer = other();
  EXPECT_EQ(contract_difference(ours(), newer), std::nullopt);
  EXPECT_EQ(contract_difference(newer, ours()), "version 1.1 required, 1.0 provided");
}

TEST_F(OtherContract, OtherMajorNeverFits) {
  contract_of_file().set_major(2);
  EXPECT_EQ(contract_difference(ours(), other()), "version 1.0 required, 2.0 provided");
}

TEST_F(OtherContract, OtherPatternNeverFits) {
  contract_of_file().set_pattern(PUSH_TIMED);
  EXPECT_EQ(contract_difference(ours(), other()), "the pattern differs");
}

TEST_F(OtherContract, OtherServiceIsNamed) {
  EXPECT_EQ(contract_difference(ours(), other("Numbers")),
            "service fiona.sdk_test.RuledObjects is not fiona.sdk_test.Numbers");
}

// ---- rules ----------------------------------------------------------------------------------------------------

class Rules : public ::testing::Test {
 protected:
  std::optional<std::string> violation() const { return rules.first_violation(object); }
  const ObjectRules rules{*Ruled::descriptor()};
  Ruled object;
};

TEST_F(Rules, DefaultObjectBreaksNone) { EXPECT_EQ(violation(), std::nullopt); }

TEST_F(Rules, LimitsAreInclusive) {
  object.set_length(10);
  EXPECT_EQ(violation(), std::nullopt);
  object.set_length(10.5);
  EXPECT_EQ(violation(), "length is 10.5, above 10 m");
  object.set_length(-1);
  EXPECT_EQ(violation(), "length is -1, below 0 m");
}

TEST_F(Rules, NotANumberAndInfinityAreRefusedUnlessAllowed) {
  object.set_anything(std::numeric_limits<double>::infinity());
  EXPECT_EQ(violation(), std::nullopt);
  object.set_length(std::numeric_limits<double>::quiet_NaN());
  EXPECT_EQ(violation(), "length is nan, not a finite number");
}

TEST_F(Rules, ArrayHasItsLengthOrNone) {
  object.add_triple(0);
  object.add_triple(0);
  EXPECT_EQ(violation(), "triple has 2 elements, not 3");
  object.add_triple(0);
  EXPECT_EQ(violation(), std::nullopt);
}

TEST_F(Rules, EachElementIsChecked) {
  for (const double value : {0.0, 1.0, 1.5}) object.add_triple(value);
  EXPECT_EQ(violation(), "triple[2] is 1.5, above 1");
}

TEST_F(Rules, CovarianceIsSymmetricPositiveSemidefiniteAndSquare) {
  const auto with = [this](const std::vector<double>& elements) {
    object.mutable_spread()->Assign(elements.begin(), elements.end());
    return violation();
  };
  const std::string none = "spread is no covariance: not symmetric and positive semi-definite";
  EXPECT_EQ(with({}), std::nullopt) << "not known";
  EXPECT_EQ(with({0, 0, 0, 0}), std::nullopt) << "certain";
  EXPECT_EQ(with({4, 6, 6, 9}), std::nullopt) << "of rank 1, as of two that are the same";
  EXPECT_EQ(with({1e-20, 0, 0, 1e300}), std::nullopt);
  EXPECT_EQ(with({4, 6.1, 6.1, 9}), none);
  EXPECT_EQ(with({4, 1, 2, 9}), none);
  EXPECT_EQ(with({-1e-3}), none);
  EXPECT_EQ(with({0, 1, 1, 0}), none);
  EXPECT_EQ(with({1, 0, 0}), none);
  EXPECT_EQ(with({1e308, -1e308, -1e308, 1e308}), std::nullopt);
  EXPECT_EQ(with({1, 0, 0, std::nan("")}), "spread[3] is nan, not a finite number");
}

TEST_F(Rules, StringIsAtMostItsSize) {
  object.set_name("four");
  EXPECT_EQ(violation(), std::nullopt);
  object.set_name("fives");
  EXPECT_EQ(violation(), "name has 5 bytes, more than 4");
}

TEST_F(Rules, NestedObjectsAreCheckedAndNamedByTheirPath) {
  object.mutable_inner()->set_angle(4);
  EXPECT_EQ(violation(), "inner.angle is 4, above 3.2 rad");
  object.clear_inner();
  object.add_list();
  object.add_list()->set_angle(std::nan(""));
  EXPECT_EQ(violation(), "list[1].angle is nan, not a finite number");
}

TEST_F(Rules, ListOfObjectsIsAtMostItsSize) {
  for (int i = 0; i < 3; ++i) object.add_list();
  EXPECT_EQ(violation(), "list has 3 elements, more than 2");
}

TEST_F(Rules, AbsentOptionalFieldBreaksNone) {
  EXPECT_EQ(violation(), std::nullopt);
  object.set_maybe(0);
  EXPECT_EQ(violation(), "maybe is 0, below 1");
}

// ---- parameters -----------------------------------------------------------------------------------------------

class Adjustable final : public Component {
 public:
  using Component::Component;
  int changes() const { return changes_; }
  const Settings& settings() const { return *params_; }

 private:
  void check(const Settings& draft) const {
    if (draft.label() == "forbidden")
      throw Error(ErrorCode::Usage, {.what = "this label is taken", .found = draft.label()});
  }
  void changed() {
    if (params_->label() == "too late") throw Error(ErrorCode::Failed, {.what = "the device does not take this label"});
    ++changes_;
  }

  int changes_ = 0;
  Params<Settings> params_{*this, &Adjustable::check, &Adjustable::changed};
};

class Parameters : public ::testing::Test {
 protected:
  Parameters() { made.hull.set_mode(kModeActive, std::chrono::seconds(1)); }

  static control::Argument number(const std::string& name, double value, const std::string& unit = "") {
    control::Argument one;
    one.set_name(name);
    one.mutable_value()->set_number(value);
    one.mutable_value()->set_unit(unit);
    return one;
  }
  static control::Argument word(const std::string& name, const std::string& value) {
    control::Argument one;
    one.set_name(name);
    one.mutable_value()->set_text(value);
    return one;
  }
  static control::Argument whole(const std::string& name, std::int64_t value, const std::string& typed) {
    control::Argument one;
    one.set_name(name);
    one.mutable_value()->set_integer(value);
    one.mutable_value()->set_typed(typed);
    return one;
  }
  void set(const std::vector<control::Argument>& changes) {
    made.hull.set_parameters(changes, std::chrono::seconds(1));
  }
  ErrorText refusal_of(const std::vector<control::Argument>& changes) {
    try {
      set(changes);
    } catch (const Error& error) {
      return error.text();
    }
    return {.what = "it was taken"};
  }

  testing::InlineExecutor executor;
  VirtualClock clock;
  KeptEvents events;
  Made<Adjustable> made{"knob", executor, clock, events};
};

TEST_F(Parameters, BeginWithTheirDeclaredDefaults) {
  EXPECT_EQ(made->settings().gain(), 0.5);
  EXPECT_EQ(made->settings().count(), 3U);
  EXPECT_EQ(made->settings().colour(), GREEN);
  EXPECT_THAT(made.hull.parameters()->differences(), IsEmpty());
}

TEST_F(Parameters, SeveralChangeTogetherAndAreToldOnce) {
  set({number("gain", 0.7), number("window_s", 1500, "ms"), number("inner.angle", 90, "deg")});
  EXPECT_EQ(made->settings().gain(), 0.7);
  EXPECT_EQ(made->settings().window_s(), 1.5);
  EXPECT_NEAR(made->settings().inner().angle(), 1.5707963, 1e-6);
  EXPECT_EQ(made->changes(), 1);
}

TEST_F(Parameters, OneWrongAmongSeveralChangesNothing) {
  EXPECT_EQ(refusal_of({number("gain", 0.7), number("count", -1)}).expected, "a whole number from 0 to 4294967295");
  EXPECT_EQ(made->settings().gain(), 0.5);
  EXPECT_EQ(made->changes(), 0);
}

TEST_F(Parameters, ComponentsOwnCheckSeesTheWholeDraftAndMayRefuse) {
  const auto text = refusal_of({number("gain", 0.7), word("label", "forbidden")});
  EXPECT_EQ(text.what, "this label is taken");
  EXPECT_EQ(text.where, "knob");
  EXPECT_EQ(text.next, "get knob");
  EXPECT_EQ(made->settings().gain(), 0.5);
  EXPECT_EQ(made->settings().label(), "");
}

TEST_F(Parameters, WhatIsRefusedAfterTheSwitchIsTakenBack) {
  const auto text = refusal_of({number("gain", 0.7), word("label", "too late")});
  EXPECT_EQ(text.what, "the device does not take this label");
  EXPECT_EQ(text.where, "knob");
  EXPECT_EQ(made->settings().gain(), 0.5);
  EXPECT_EQ(made->settings().label(), "");
  EXPECT_THAT(made.hull.parameters()->differences(), IsEmpty());
}

TEST_F(Parameters, TextTakesANumberAsItWasTyped) {
  set({whole("label", 7, "007")});
  EXPECT_EQ(made->settings().label(), "007");
}

TEST_F(Parameters, TextTakesAFlagAsItWasTyped) {
  auto flag = word("label", "");
  flag.mutable_value()->set_flag(true);
  flag.mutable_value()->set_typed("true");
  set({flag});
  EXPECT_EQ(made->settings().label(), "true");
}

TEST_F(Parameters, TextDoesNotGuessHowANumberWasTyped) {
  const auto text = refusal_of({number("label", 7)});
  EXPECT_EQ(text.expected, "a word or a quoted string");
  EXPECT_EQ(text.found, "7");
}

TEST_F(Parameters, TextRefusesAList) {
  auto list = word("label", "");
  list.mutable_value()->mutable_list();
  EXPECT_EQ(refusal_of({list}).expected, "a word or a quoted string");
}

TEST_F(Parameters, ProtobufTextThatDoesNotParseIsToldWithItsPlace) {
  auto inner = word("inner", "");
  inner.mutable_value()->set_message("angel: 1");
  const auto text = refusal_of({inner});
  EXPECT_EQ(text.expected,
            "protobuf text of fiona.sdk_test.Inner in braces; at 1:6: Message type \"fiona.sdk_test.Inner\" has no "
            "field named \"angel\".");
  EXPECT_EQ(text.found, "{angel: 1}");
}

TEST(ProtobufText, ThatIsNestedWithoutEndIsRefused) {
  google::protobuf::DescriptorProto nested;
  control::Argument all;
  for (int i = 0; i < 200'000; ++i) all.mutable_value()->mutable_message()->append("nested_type{");
  try {
    set_fields(nested, {&all, 1});
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.text().expected, ::testing::HasSubstr("recursion"));
  }
}

TEST_F(Parameters, UnknownEnumeratorGetsTheNearest) {
  const auto text = refusal_of({word("colour", "GRENE")});
  EXPECT_EQ(text.expected, "one of RED, GREEN");
  EXPECT_THAT(text.near, ElementsAre("GREEN"));
}

TEST_F(Parameters, UnknownNestedNameGetsTheNearest) {
  const auto text = refusal_of({number("inner.angel", 1)});
  EXPECT_EQ(text.what, "there is no parameter 'inner.angel'");
  EXPECT_THAT(text.near, ElementsAre("angle"));
}

TEST_F(Parameters, DifferencesGiveTheValuesBack) {
  set({number("gain", 0.1), word("label", "a \"quoted\" word"), word("colour", "RED")});
  Settings copy;
  set_declared_defaults(copy);
  set_fields(copy, made.hull.parameters()->differences());
  EXPECT_EQ(copy.SerializeAsString(), made->settings().SerializeAsString());
}

TEST(DeclaredDefault, OutsideItsOwnRangeIsTheAuthorsMistake) {
  ImpossibleDefault message;
  try {
    set_declared_defaults(message);
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "the declared default breaks its own rule: gain is 5, above 1");
    EXPECT_EQ(error.text().where, "fiona.sdk_test.ImpossibleDefault");
  }
}

// ---- units, names, messages -----------------------------------------------------------------------------------

double converted(double value, std::string_view from, std::string_view to) {
  const auto conversion = convert_unit(from, to);
  return conversion ? value * conversion->factor + conversion->offset : std::nan("");
}

TEST(Units, ConvertWithinADimension) {
  EXPECT_DOUBLE_EQ(converted(200, "ms", "s"), 0.2);
  EXPECT_DOUBLE_EQ(converted(180, "deg", "rad"), std::acos(-1.0));
  EXPECT_DOUBLE_EQ(converted(20, "degC", "K"), 293.15);
  EXPECT_DOUBLE_EQ(converted(293.15, "K", "degC"), 20);
  EXPECT_DOUBLE_EQ(converted(1, "g", "m/s^2"), 9.80665);
  EXPECT_DOUBLE_EQ(converted(50, "uT", "gauss"), 0.5);
  EXPECT_DOUBLE_EQ(converted(36, "km/h", "m/s"), 10);
}

TEST(Units, DoNotConvertBetweenDimensionsNorFromUnknownOnes) {
  EXPECT_FALSE(convert_unit("m", "s").has_value());
  EXPECT_FALSE(convert_unit("rad", "rad/s").has_value());
  EXPECT_FALSE(convert_unit("furlong", "m").has_value());
}

TEST(Units, EqualSymbolsConvertEvenIfUnknown) { EXPECT_DOUBLE_EQ(converted(3, "furlong", "furlong"), 3); }

TEST(NearestNames, FindTyposSwapsAndPrefixesBestFirst) {
  const std::vector<std::string> verbs{"load", "unload", "loadable", "watch", "wire"};
  EXPECT_THAT(nearest_names("laod", verbs), ElementsAre("load"));
  EXPECT_THAT(nearest_names("lo", verbs), ElementsAre("load", "loadable"));
  EXPECT_THAT(nearest_names("wach", verbs), ElementsAre("watch"));
}

TEST(NearestNames, OfferAtMostThreeAndNoneThatIsFar) {
  const std::vector<std::string> ports{"port1", "port2", "port3", "port4"};
  EXPECT_THAT(nearest_names("port", ports), ElementsAre("port1", "port2", "port3"));
  EXPECT_THAT(nearest_names("zebra", ports), IsEmpty());
  EXPECT_THAT(nearest_names("", ports), IsEmpty());
}

TEST(ErrorRendering, PutsEachPartOnALineOfItsOwn) {
  const Error error(ErrorCode::NotFound, {.what = "no such port",
                                          .where = "nav.loc",
                                          .expected = "a port",
                                          .found = "nothing",
                                          .next = "show nav",
                                          .near = {"location", "locate"}});
  EXPECT_STREQ(error.what(),
               "nav.loc: no such port\n  expected: a port\n  found: nothing\n  did you mean: location, locate\n  next: "
               "show nav");
}

// ---- numbers that no int64 and no double holds ----------------------------------------------------------------

class Generous final : public Component {
 public:
  using Component::Component;
  const Large& values() const { return *params_; }

 private:
  Params<Large> params_{*this};
};

class LargeNumbers : public ::testing::Test {
 protected:
  static control::Argument typed(const std::string& name, double value, const std::string& text) {
    control::Argument one;
    one.set_name(name);
    one.mutable_value()->set_number(value);
    one.mutable_value()->set_typed(text);
    return one;
  }
  void set(const control::Argument& change) { made.hull.set_parameters({&change, 1}, kLimit); }
  std::string shown(int parameter) {
    return made.hull.parameters()->status().at(static_cast<std::size_t>(parameter)).value();
  }

  testing::InlineExecutor executor;
  VirtualClock clock;
  KeptEvents events;
  Made<Generous> made{"generous", executor, clock, events};
  static constexpr std::uint64_t kMost = std::numeric_limits<std::uint64_t>::max();
};

TEST_F(LargeNumbers, AreDefaultsAsTheyAreWritten) {
  EXPECT_EQ(made->values().natural(), kMost);
  EXPECT_EQ(shown(0), "18446744073709551615");
  EXPECT_EQ(made->values().real(), 1e20);
  EXPECT_THAT(made.hull.parameters()->differences(), IsEmpty());
}

TEST_F(LargeNumbers, KeepAllTheirDigits) {
  set(typed("natural", 18446744073709551614.0, "18446744073709551614"));
  EXPECT_EQ(made->values().natural(), kMost - 1);
  EXPECT_EQ(shown(0), "18446744073709551614");
  const auto saved = made.hull.parameters()->differences();
  ASSERT_THAT(saved, SizeIs(1));
  Made<Generous> again("again", executor, clock, events);
  again.hull.set_parameters(saved, kLimit);
  EXPECT_EQ(again->values().natural(), kMost - 1);
  const Changes changes = Changes().set("again", "natural", kMost - 2);
  again.hull.set_parameters({&changes.list()[0].set().parameters(0), 1}, kLimit);
  EXPECT_EQ(again->values().natural(), kMost - 2);
}

TEST_F(LargeNumbers, MayBeTypedWithAPointUpToTheBoundThatTheRefusalNames) {
  set(typed("word", 4294967295.0, "4294967295.0"));
  EXPECT_EQ(made->values().word(), 4294967295U);
  EXPECT_THAT([&] { set(typed("word", 4294967296.0, "4294967296")); },
              ThrowsMessage<Error>(HasSubstr("expected: a whole number from 0 to 4294967295")));
  EXPECT_THAT([&] { set(typed("natural", 18446744073709551616.0, "18446744073709551616")); },
              ThrowsMessage<Error>(HasSubstr("expected: a whole number from 0 to 18446744073709551615")));
}

TEST(LargeDefault, BeyondWhatItsFieldHoldsIsRefused) {
  TooLargeDefault message;
  EXPECT_THAT([&] { set_declared_defaults(message); }, ThrowsMessage<Error>(HasSubstr("18446744073709551615")));
}

TEST(DeclaredDefaults, OfATypeWhoseFieldsHaveNoEndAreRefused) {
  Endless endless;
  EXPECT_THAT([&] { set_declared_defaults(endless); },
              ThrowsMessage<Error>(HasSubstr("contains itself: fiona.sdk_test.Endless")));
}

/// Eight fields of eight fields, four times over.
TEST(DeclaredDefaults, OfATypeWithFarTooManyFieldsAreRefused) {
  google::protobuf::FileDescriptorProto file;
  file.set_name("wide.proto");
  for (const char level : {'A', 'B', 'C', 'D'}) {
    auto& type = *file.add_message_type();
    type.set_name(std::string(1, level));
    for (int i = 1; i <= 8; ++i) {
      auto& field = *type.add_field();
      field.set_name("field_" + std::to_string(i));
      field.set_number(i);
      field.set_type(level < 'D' ? field.TYPE_MESSAGE : field.TYPE_DOUBLE);
      if (level < 'D') field.set_type_name("." + std::string(1, static_cast<char>(level + 1)));
    }
  }
  google::protobuf::DescriptorPool pool;
  google::protobuf::DynamicMessageFactory factory;
  const std::unique_ptr<Object> wide(factory.GetPrototype(pool.BuildFile(file)->message_type(0))->New());
  EXPECT_THAT([&] { set_declared_defaults(*wide); }, ThrowsMessage<Error>(HasSubstr("more than 4096 fields")));
}

TEST(DeclaredDefaults, LeaveAChoiceOpen) {
  Either either;
  set_declared_defaults(either);
  EXPECT_EQ(either.which_case(), Either::WHICH_NOT_SET);
}

TEST(Differences, OfAChoiceTouchNeither) {
  Either turned;
  turned.mutable_turn()->set_angle(1);
  Either set;
  set.mutable_settings()->set_gain(1);
  const auto changed = differences(turned, set);
  EXPECT_EQ(changed.size(), 2U);
  EXPECT_EQ(turned.turn().angle(), 1);
  EXPECT_EQ(set.settings().gain(), 1);
}

}  // namespace
}  // namespace fiona::sdk_test
