#include "text_check.hpp"

#include <google/protobuf/descriptor.h>
#include <google/protobuf/descriptor.pb.h>
#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>

#include <array>
#include <cstdint>
#include <fiona/error.hpp>
#include <utility>
#include <vector>

namespace fiona::marketplace {
namespace {

constexpr std::uint32_t kNotUtf8 = 0xffffffff;

// The next character of `text`, which it is shortened by. RFC 3629: no overlong forms, no surrogates.
std::uint32_t take_character(std::string_view& text) {
  const auto first = static_cast<unsigned char>(text.front());
  text.remove_prefix(1);
  if (first < 0x80) return first;
  const std::size_t more = first >= 0xf0 ? 3 : first >= 0xe0 ? 2 : 1;
  if (first < 0xc2 || first > 0xf4 || text.size() < more) return kNotUtf8;
  std::uint32_t character = first & (0x3f >> more);
  for (std::size_t i = 0; i < more; ++i) {
    const auto byte = static_cast<unsigned char>(text[i]);
    if ((byte & 0xc0) != 0x80) return kNotUtf8;
    character = character << 6 | (byte & 0x3f);
  }
  text.remove_prefix(more);
  constexpr std::array<std::uint32_t, 4> kLeast{0, 0x80, 0x800, 0x10000};
  const bool surrogate = character >= 0xd800 && character < 0xe000;
  return character < kLeast[more] || surrogate || character > 0x10ffff ? kNotUtf8 : character;
}

bool is_hidden(std::uint32_t c) {
  constexpr std::array<std::pair<std::uint32_t, std::uint32_t>, 8> kRanges{{{0x00, 0x1f},
                                                                            {0x7f, 0x9f},
                                                                            {0x200b, 0x200f},
                                                                            {0x2028, 0x202e},
                                                                            {0x2060, 0x206f},
                                                                            {0xfeff, 0xfeff},
                                                                            {0xfff9, 0xfffb},
                                                                            {0xe0000, 0xe0fff}}};
  for (const auto& [first, last] : kRanges) {
    if (c >= first && c <= last) return true;
  }
  return false;
}

// The first mistake only: those after it are mostly its consequences.
class FirstMistake : public google::protobuf::io::ErrorCollector {
 public:
  void AddError(int line, google::protobuf::io::ColumnNumber column, const std::string& message) override {
    if (place.empty()) {
      place = ":" + std::to_string(line + 1) + ":" + std::to_string(column + 1);
      text = text_fault(message, false).empty() ? message : "there is a byte here that is not text";
    }
  }
  std::string place;
  std::string text;
};

}  // namespace

std::string text_fault(std::string_view text, bool lines) {
  while (!text.empty()) {
    const std::uint32_t character = take_character(text);
    if (character == kNotUtf8) return "is not UTF-8";
    if (is_hidden(character) && !(lines && character == '\n')) return "has a control or invisible character";
  }
  return {};
}

std::string texts_fault(const google::protobuf::Message& message) {
  const auto* reflection = message.GetReflection();
  std::vector<const google::protobuf::FieldDescriptor*> fields;
  reflection->ListFields(message, &fields);
  for (const auto* field : fields) {
    const int count = field->is_repeated() ? reflection->FieldSize(message, field) : 1;
    for (int i = 0; i < count; ++i) {
      std::string fault;
      if (field->type() == google::protobuf::FieldDescriptor::TYPE_STRING) {
        const std::string text = field->is_repeated() ? reflection->GetRepeatedString(message, field, i)
                                                      : reflection->GetString(message, field);
        fault = text_fault(text, field->name() == "doc" || field->name() == "hello");
        if (!fault.empty()) return field->name() + " " + fault;
      } else if (field->message_type() &&
                 field->message_type() != google::protobuf::FileDescriptorSet::descriptor()) {
        fault = texts_fault(field->is_repeated() ? reflection->GetRepeatedMessage(message, field, i)
                                                 : reflection->GetMessage(message, field));
        if (!fault.empty()) return fault;
      }
    }
  }
  return {};
}

void parse_text(std::string_view text, const std::string& where, google::protobuf::Message& message) {
  FirstMistake mistake;
  google::protobuf::TextFormat::Parser parser;
  parser.RecordErrorsTo(&mistake);
  parser.SetRecursionLimit(64);
  const std::string copy{text};
  if (!parser.ParseFromString(copy, &message) || !mistake.place.empty()) {
    throw Error(ErrorCode::Failed,
                ErrorText{.what = "this is not a " + message.GetDescriptor()->name() + ": " + mistake.text,
                          .where = where + mistake.place});
  }
  if (const std::string fault = texts_fault(message); !fault.empty()) {
    throw Error(ErrorCode::Failed, ErrorText{.what = fault, .where = where});
  }
}

}  // namespace fiona::marketplace
