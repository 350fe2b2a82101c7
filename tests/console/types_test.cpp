// Objects of types that the console has never seen.
#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include <fiona/error.hpp>

#include "types.hpp"

namespace fiona::console {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;

google::protobuf::FileDescriptorSet described(const std::string& text) {
  google::protobuf::FileDescriptorSet files;
  if (!google::protobuf::TextFormat::ParseFromString(text, &files)) throw std::runtime_error("no descriptors");
  return files;
}

/// Each type has `fields` fields of the next; the last one has itself.
google::protobuf::FileDescriptorSet nested(int types, int fields) {
  google::protobuf::FileDescriptorSet files;
  auto& file = *files.add_file();
  file.set_name("nested.proto");
  file.set_syntax("proto3");
  for (int i = 0; i < types; ++i) {
    auto& type = *file.add_message_type();
    type.set_name("T" + std::to_string(i));
    for (int k = 1; k <= fields; ++k) {
      auto& field = *type.add_field();
      field.set_name("f" + std::to_string(k));
      field.set_number(k);
      field.set_type(google::protobuf::FieldDescriptorProto::TYPE_MESSAGE);
      field.set_label(google::protobuf::FieldDescriptorProto::LABEL_OPTIONAL);
      field.set_type_name("T" + std::to_string(std::min(i + 1, types - 1)));
    }
  }
  return files;
}

TEST(Types, ThatHaveEachOtherManyTimesAreATableThatEnds) {
  const TypeSet types(nested(12, 20));
  const Table table = field_table(*types.object("T0"));
  EXPECT_EQ(table.size(), 1001U);
  EXPECT_THAT(table.lines().back(), HasSubstr("the type has more fields"));
}

TEST(Types, ThatHaveThemselvesAreTheirFieldsOnce) {
  const TypeSet types(nested(1, 2));
  EXPECT_EQ(field_table(*types.object("T0")).size(), 2U);
}

TEST(Types, OfTooManyFilesAreRefused) {
  google::protobuf::FileDescriptorSet files;
  for (int i = 0; i < 1001; ++i) files.add_file()->set_name(std::to_string(i) + ".proto");
  try {
    const TypeSet types(files);
    FAIL() << "they were read";
  } catch (const Error& error) {
    EXPECT_EQ(error.text().what, "too many protos to read their types");
    EXPECT_EQ(error.text().found, "1001 files");
  }
}

TEST(Types, ElementOfAListIsThereOnlyWithinIt) {
  const TypeSet types(described(R"(file { name: "l.proto" syntax: "proto3" message_type { name: "L"
      field { name: "n" number: 1 type: TYPE_INT32 label: LABEL_REPEATED } } })"));
  const auto object = types.make("L");
  google::protobuf::TextFormat::ParseFromString("n: [7, 8]", object.get());
  ASSERT_THAT(field_texts(*object, {"n[1]"}), SizeIs(1));
  EXPECT_EQ(field_texts(*object, {"n[1]"})[0].text, "8");
  EXPECT_THAT(field_texts(*object, {"n[2]"}), SizeIs(0));
  EXPECT_THAT(field_texts(*object, {"n[-1]"}), SizeIs(0));
}

const char* const kKeys = R"(file { name: "k.proto" syntax: "proto3" dependency: "fiona/options.proto"
    message_type { name: "Key"
      field { name: "door" number: 1 type: TYPE_STRING label: LABEL_OPTIONAL }
      field { name: "pin" number: 2 type: TYPE_INT32 label: LABEL_OPTIONAL options { [fiona.secret]: true } } }
    message_type { name: "Ring"
      field { name: "keys" number: 1 type: TYPE_MESSAGE type_name: "Key" label: LABEL_REPEATED }
      field { name: "rooms" number: 2 type: TYPE_MESSAGE type_name: "Ring.RoomsEntry" label: LABEL_REPEATED }
      field { name: "code" number: 3 type: TYPE_BYTES label: LABEL_OPTIONAL options { [fiona.secret]: true } }
      nested_type { name: "RoomsEntry" options { map_entry: true }
        field { name: "key" number: 1 type: TYPE_STRING label: LABEL_OPTIONAL }
        field { name: "value" number: 2 type: TYPE_MESSAGE type_name: "Key" label: LABEL_OPTIONAL } } } })";

TEST(Types, SecretsAreNamedAndNotShown) {
  const TypeSet types(described(kKeys));
  const auto ring = types.make("Ring");
  google::protobuf::TextFormat::ParseFromString(
      R"(keys { door: "a" pin: 1234 } keys { pin: 1234 } rooms { key: "hall" value { pin: 1234 } } code: "1234")",
      ring.get());
  std::string text;
  for (const FieldText& field : field_texts(*ring, {})) text += field.path + "=" + field.text + " ";
  EXPECT_EQ(text,
            "keys[0].door=\"a\" keys[0].pin=(secret) keys[1].door=\"\" keys[1].pin=(secret) "
            "rooms[0].key=\"hall\" rooms[0].value.door=\"\" rooms[0].value.pin=(secret) code=(secret) ");
  EXPECT_EQ(
      object_json(*ring).dump(),
      R"({"code":null,"keys":[{"door":"a","pin":null},{"door":"","pin":null}],"rooms":{"hall":{"door":"","pin":null}}})");
}

TEST(Types, ASecretThatIsNotSetIsSeenNotToBe) {
  const TypeSet types(described(kKeys));
  EXPECT_EQ(field_texts(*types.make("Ring"), {"code"})[0].text, "<0 bytes>");
}

}  // namespace
}  // namespace fiona::console
