#include "text_check.hpp"

#include <google/protobuf/descriptor.h>
#include <google/protobuf/descriptor.pb.h>
#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>

#include <fiona/error.hpp>
#include <vector>

#include "fiona/unicode.hpp"

namespace fiona::marketplace {
namespace {

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
    const unicode::Character next = unicode::decode(text);
    if (!next.valid) return "is not UTF-8";
    if (unicode::is_hidden(next.code) && !(lines && next.code == '\n')) return "has a control or invisible character";
    text.remove_prefix(next.bytes);
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
        fault = text_fault(text, field->name() == "doc" || field->name() == "try");
        if (!fault.empty()) return field->name() + " " + fault;
      } else if (field->message_type() && field->message_type() != google::protobuf::FileDescriptorSet::descriptor()) {
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
                          .where = where + mistake.place,
                          .next = "correct it there; what it may hold is in the .proto of its type"});
  }
  if (const std::string fault = texts_fault(message); !fault.empty()) {
    throw Error(ErrorCode::Failed,
                ErrorText{.what = fault, .where = where, .next = "write it as plain text of one line"});
  }
}

}  // namespace fiona::marketplace
