// R32: the value of a field that is marked secret reaches whom it is sent to, and nobody who only looks on.
#include "fiona/secrets.hpp"

#include <gmock/gmock.h>
#include <google/protobuf/dynamic_message.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include "field_compare.hpp"
#include "fiona/component.hpp"
#include "fiona/params.hpp"
#include "fiona/rules.hpp"
#include "fiona/security.pb.h"
#include "fiona/testing/bench.hpp"
#include "taps.hpp"

namespace fiona::host {
namespace {

using namespace std::chrono_literals;
using security::CommAuthenticationRequest;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

const char* const kCanary = "canary in a mine";

CommAuthenticationRequest login(const std::string& password) {
  CommAuthenticationRequest request;
  request.set_username("anna");
  request.set_password(password);
  return request;
}

template <class F>
std::string error_of(F request) {
  try {
    request();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

/// Types that are made for a test.
class Described {
 public:
  explicit Described(const std::string& text) {
    google::protobuf::FileDescriptorProto file;
    EXPECT_TRUE(google::protobuf::TextFormat::ParseFromString(text, &file));
    pool_.BuildFile(file);
  }
  std::unique_ptr<Object> read(const std::string& type, const std::string& text) {
    std::unique_ptr<Object> object(factory_.GetPrototype(pool_.FindMessageTypeByName(type))->New());
    EXPECT_TRUE(google::protobuf::TextFormat::ParseFromString(text, object.get())) << text;
    return object;
  }

 private:
  google::protobuf::DescriptorPool pool_;
  google::protobuf::DynamicMessageFactory factory_{&pool_};
};

const char* const kKeyRing = R"(
  name: "ring.proto" syntax: "proto3"
  message_type { name: "Key"
    field { name: "door" number: 1 type: TYPE_STRING label: LABEL_OPTIONAL }
    field { name: "pin" number: 2 type: TYPE_INT32 label: LABEL_OPTIONAL options { [fiona.secret]: true [fiona.max]: 9999 } } }
  message_type { name: "Ring"
    field { name: "first" number: 1 type: TYPE_MESSAGE type_name: "Key" label: LABEL_OPTIONAL }
    field { name: "more" number: 2 type: TYPE_MESSAGE type_name: "Key" label: LABEL_REPEATED }
    field { name: "ring" number: 3 type: TYPE_MESSAGE type_name: "Ring" label: LABEL_OPTIONAL }
    field { name: "words" number: 4 type: TYPE_STRING label: LABEL_REPEATED options { [fiona.secret]: true } } })";

TEST(Secrets, AreTakenOutOfACopyAtAnyDepth) {
  Described types(kKeyRing);
  const auto ring = types.read("Ring", R"(first { door: "a" pin: 1 } more { door: "b" pin: 2 } more { pin: 3 }
                                          ring { first { door: "c" pin: 4 } } words: "x" words: "y")");
  EXPECT_EQ(first_secret(*ring->GetDescriptor()), "first.pin");
  EXPECT_EQ(WithoutSecrets(*ring)->ShortDebugString(),
            R"(first { door: "a" } more { door: "b" } more { } ring { first { door: "c" } })");
  EXPECT_THAT(ring->ShortDebugString(), HasSubstr("pin: 4")) << "the object itself keeps them";
}

TEST(Secrets, AnObjectThatCanHaveNoneIsNotCopied) {
  const security::CommSession session;
  EXPECT_EQ(&*WithoutSecrets(session), &session);
}

class Door final : public Component {
 public:
  using Component::Component;
  Probe<CommAuthenticationRequest> asked{*this, "asked"};
};

TEST(Secrets, AProbeIsReadListedAndWatchedWithoutThem) {
  std::vector<std::string> told;
  const Taps::OnEvent on_event = [&told](const wire::GroupMessage& message) {
    told.push_back(message.tapped().object());
  };
  testing::Bench<Door> bench("door");  // ends its taps with a word to on_event
  bench.start();
  Taps taps(on_event);
  wire::Tap tap;
  tap.mutable_watch()->mutable_port()->set_port("asked");
  taps.tap(tap, bench.hull());
  bench.component().asked.set(login(kCanary));
  bench.advance(1s);
  told.push_back(read_probe(bench.hull(), "asked").object());
  control::InstanceStatus status;
  fill_probes(status, bench.hull(), bench.now());
  told.push_back(status.SerializeAsString());
  ASSERT_GE(told.size(), 3U);
  for (const std::string& bytes : told) EXPECT_THAT(bytes, AllOf(HasSubstr("anna"), Not(HasSubstr("canary"))));
}

TEST(Secrets, AreNotCompared) {
  control::Value guess;
  guess.set_text("a guess");
  EXPECT_EQ(error_of([&] { compare_field(login(kCanary), "password", control::EQUAL, guess); }),
            "password: 'password' is secret: it is neither shown nor compared\n  next: compare another field");
}

/// What a recorder of deliveries is told.
class Told final : public DeliveryRecorder {
 public:
  void delivered(TimePoint, std::string_view, std::uint64_t, std::string_view what) override { all.emplace_back(what); }
  void round(TimePoint) override {}
  std::vector<std::string> all;
};

std::string recorded(const Object& object) {
  VirtualClock clock;
  const auto told = std::make_shared<Told>();
  clock.set_recorder(told);
  clock.stage({.wire = "wire", .sequence = 1, .object = &object, .deliver = [] {}});
  clock.release();
  clock.stop();
  return told->all.empty() ? "nothing" : told->all.front();
}

TEST(Secrets, ARecordOfDeliveriesHasNoHashByWhichAPasswordCouldBeGuessed) {
  EXPECT_EQ(recorded(login(kCanary)).size(), 16U);
  EXPECT_EQ(recorded(login(kCanary)), recorded(login("another one")));
  CommAuthenticationRequest other = login(kCanary);
  other.set_username("bert");
  EXPECT_NE(recorded(login(kCanary)), recorded(other));
}

TEST(Secrets, ARefusalDoesNotRepeatThem) {
  CommAuthenticationRequest request;
  std::vector<control::Argument> list(1), text(1), broken(1);
  list[0].set_name("password");
  list[0].mutable_value()->mutable_list()->add_values()->set_text(kCanary);
  list[0].mutable_value()->mutable_list()->add_values()->set_text(kCanary);
  text[0].mutable_value()->set_message("username: \"anna\" password: canary");
  broken[0].mutable_value()->set_message("username: \"anna\" password: \"canary\" nonsense");
  std::vector<control::Argument> object(1);
  object[0].set_name("password");
  object[0].mutable_value()->set_message("canary");
  for (const auto& arguments : {list, text, broken, object}) {
    const std::string error = error_of([&] { set_fields(request, arguments); });
    EXPECT_THAT(error, AllOf(Not(HasSubstr("no error")), Not(HasSubstr("canary"))));
  }
  EXPECT_THAT(error_of([&] { set_fields(request, broken); }),
              HasSubstr("expected: protobuf text of fiona.security.CommAuthenticationRequest in braces; at 1:45"));
}

TEST(Secrets, ARuleThatIsBrokenSaysByWhatAndNotHow) {
  Described types(kKeyRing);
  const auto key = types.read("Key", "pin: 12345");
  EXPECT_EQ(ObjectRules(*key->GetDescriptor()).first_violation(*key), "pin is not as its rule says");
}

class Careless final : public Component {
 public:
  using Component::Component;
  Params<CommAuthenticationRequest> params{*this};
};

TEST(Secrets, NoParameterIsOneSinceEachIsShownAndKept) {
  EXPECT_EQ(error_of([] { testing::Bench<Careless> bench("careless"); }),
            "careless: 'password' is secret, and no parameter is: each is shown, saved and kept in the journal\n"
            "  next: let a parameter name a file that holds it");
}

}  // namespace
}  // namespace fiona::host
