#include "value_text.hpp"

#include <fmt/format.h>
#include <google/protobuf/descriptor.h>
#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>

#include <charconv>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "fiona/error.hpp"
#include "fiona/options.pb.h"
#include "fiona/params.hpp"
#include "fiona/readable_text.hpp"
#include "fiona/secrets.hpp"
#include "fiona/typed_value.hpp"
#include "fiona/units.hpp"

namespace fiona::detail {

using control::Value;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;

namespace {

/// As deep as an object may be that comes as bytes: a deeper one would end the process that reads it.
constexpr int kDeepestText = 100;

std::string in_quotes(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    if (c == '\n') {
      out += "\\n";
    } else {
      out += c;
    }
  }
  return out + "\"";
}

template <class T>
std::optional<T> read_all(const std::string& text) {
  T number{};
  const char* end = text.data() + text.size();
  const auto read = std::from_chars(text.data(), end, number);
  return read.ec == std::errc{} && read.ptr == end ? std::optional(number) : std::nullopt;
}

/// A whole number beyond what an int64 holds, as it was typed: its double has not all of its digits.
std::optional<std::uint64_t> large_whole(const Value& value) {
  if (value.kind_case() != Value::kNumber || !value.unit().empty()) return std::nullopt;
  const auto number = read_all<std::uint64_t>(value.typed());
  return number && static_cast<double>(*number) == value.number() ? number : std::nullopt;
}

/// As the console would type it.
std::string value_text(const Value& value) {
  if (const auto large = large_whole(value)) return std::to_string(*large);
  switch (value.kind_case()) {
    case Value::kNumber: return fmt::format("{}{}", value.number(), value.unit());
    case Value::kInteger: return fmt::format("{}{}", value.integer(), value.unit());
    case Value::kFlag: return value.flag() ? "true" : "false";
    case Value::kText: return in_quotes(value.text());
    case Value::kMessage: return "{" + value.message() + "}";
    case Value::kList: {
      std::vector<std::string> parts;
      for (const auto& one : value.list().values()) parts.push_back(value_text(one));
      return fmt::format("[{}]", fmt::join(parts, ", "));
    }
    default: return "nothing";
  }
}

std::vector<std::string> enumerators(const FieldDescriptor& field) {
  std::vector<std::string> names;
  for (int i = 0; i < field.enum_type()->value_count(); ++i) names.push_back(field.enum_type()->value(i)->name());
  return names;
}

bool has_secrets(const google::protobuf::Descriptor* type) { return type && first_secret(*type); }

/// The value as a refusal may repeat it.
std::string shown(const FieldDescriptor& field, const Value& value) {
  return is_secret(field) || has_secrets(field.message_type()) ? "a value that is not shown" : value_text(value);
}

[[noreturn]] void refuse(const std::string& name, const FieldDescriptor& field, const Value& value,
                         std::string expected) {
  std::vector<std::string> near;
  if (field.cpp_type() == FieldDescriptor::CPPTYPE_ENUM) near = nearest_names(value.text(), enumerators(field));
  throw Error(ErrorCode::Usage, {.what = "parameter '" + name + "' does not take this value",
                                 .expected = std::move(expected),
                                 .found = shown(field, value),
                                 .near = std::move(near)});
}

/// The number in the field's unit.
double number_in_unit(const std::string& name, const FieldDescriptor& field, const Value& value) {
  const bool is_number = value.kind_case() == Value::kNumber || value.kind_case() == Value::kInteger;
  if (!is_number) refuse(name, field, value, type_text(field));
  const double typed = value.kind_case() == Value::kNumber ? value.number() : static_cast<double>(value.integer());
  if (value.unit().empty()) return typed;
  const std::string& unit = field.options().GetExtension(fiona::unit);
  const auto conversion = convert_unit(value.unit(), unit);
  if (!conversion) refuse(name, field, value, unit.empty() ? "a number without unit" : "a number in " + unit);
  return typed * conversion->factor + conversion->offset;
}

/// A whole number between the limits of T, exact where it was typed without unit.
template <class T>
T whole_number(const std::string& name, const FieldDescriptor& field, const Value& value) {
  const auto expected = [&] {
    return fmt::format("a whole number from {} to {}", std::numeric_limits<T>::min(), std::numeric_limits<T>::max());
  };
  if (value.kind_case() == Value::kInteger && value.unit().empty()) {
    if (!std::in_range<T>(value.integer())) refuse(name, field, value, expected());
    return static_cast<T>(value.integer());
  }
  if (const auto large = large_whole(value)) {
    if (!std::in_range<T>(*large)) refuse(name, field, value, expected());
    return static_cast<T>(*large);
  }
  const double number = number_in_unit(name, field, value);
  const double nearest = std::round(number);
  const bool fits = std::abs(number - nearest) < 1e-9 * std::max(1.0, std::abs(number)) &&
                    nearest >= static_cast<double>(std::numeric_limits<T>::min()) &&
                    nearest < static_cast<double>(std::numeric_limits<T>::max()) + 1;
  if (!fits) refuse(name, field, value, expected());
  return static_cast<T>(nearest);
}

/// What looks like a number or a flag is for a text field the word that was typed: 007 keeps its zeros.
const std::string& text_of(const std::string& name, const FieldDescriptor& field, const Value& value) {
  if (value.kind_case() == Value::kText) return value.text();
  const bool is_word =
      value.kind_case() == Value::kNumber || value.kind_case() == Value::kInteger || value.kind_case() == Value::kFlag;
  if (!is_word || value.typed().empty()) refuse(name, field, value, "a word or a quoted string");
  return value.typed();
}

bool flag_of(const std::string& name, const FieldDescriptor& field, const Value& value) {
  if (value.kind_case() != Value::kFlag) refuse(name, field, value, "true or false");
  return value.flag();
}

int enumerator_of(const std::string& name, const FieldDescriptor& field, const Value& value) {
  const auto* found = value.kind_case() == Value::kText ? field.enum_type()->FindValueByName(value.text()) : nullptr;
  if (!found) refuse(name, field, value, fmt::format("one of {}", fmt::join(enumerators(field), ", ")));
  return found->number();
}

/// Keeps the first complaint, which otherwise goes to the process's log.
class FirstComplaint final : public google::protobuf::io::ErrorCollector {
 public:
  void AddError(int line, int column, const std::string& text) override {
    if (!place_.empty()) return;
    place_ = fmt::format("; at {}:{}", line + 1, column + 1);
    text_ = ": " + text;
  }
  /// It may quote what it cannot read.
  std::string of(const google::protobuf::Descriptor* type) const { return has_secrets(type) ? place_ : place_ + text_; }

 private:
  std::string place_;
  std::string text_;
};

/// Adds what the text says to `target`; what had been expected where it cannot be read.
std::optional<std::string> misread(const Value& value, Message& target) {
  FirstComplaint complaint;
  google::protobuf::TextFormat::Parser parser;
  parser.RecordErrorsTo(&complaint);
  parser.SetRecursionLimit(kDeepestText);
  if (value.kind_case() == Value::kMessage && parser.MergeFromString(value.message(), &target)) return std::nullopt;
  return "protobuf text of " + target.GetDescriptor()->full_name() + " in braces" +
         complaint.of(target.GetDescriptor());
}

void parse_message(const std::string& name, const FieldDescriptor& field, const Value& value, Message& target) {
  target.Clear();
  if (const auto expected = misread(value, target)) refuse(name, field, value, *expected);
}

void set_single(Message& m, const FieldDescriptor& f, const Value& v, const std::string& name) {
  const Reflection& r = *m.GetReflection();
  switch (f.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE: return r.SetDouble(&m, &f, number_in_unit(name, f, v));
    case FieldDescriptor::CPPTYPE_FLOAT: return r.SetFloat(&m, &f, static_cast<float>(number_in_unit(name, f, v)));
    case FieldDescriptor::CPPTYPE_INT32: return r.SetInt32(&m, &f, whole_number<std::int32_t>(name, f, v));
    case FieldDescriptor::CPPTYPE_INT64: return r.SetInt64(&m, &f, whole_number<std::int64_t>(name, f, v));
    case FieldDescriptor::CPPTYPE_UINT32: return r.SetUInt32(&m, &f, whole_number<std::uint32_t>(name, f, v));
    case FieldDescriptor::CPPTYPE_UINT64: return r.SetUInt64(&m, &f, whole_number<std::uint64_t>(name, f, v));
    case FieldDescriptor::CPPTYPE_BOOL: return r.SetBool(&m, &f, flag_of(name, f, v));
    case FieldDescriptor::CPPTYPE_ENUM: return r.SetEnumValue(&m, &f, enumerator_of(name, f, v));
    case FieldDescriptor::CPPTYPE_STRING: return r.SetString(&m, &f, text_of(name, f, v));
    case FieldDescriptor::CPPTYPE_MESSAGE: {
      Message& nested = *r.MutableMessage(&m, &f);
      nested.Clear();
      return parse_message(name, f, v, nested);
    }
  }
}

void add_element(Message& m, const FieldDescriptor& f, const Value& v, const std::string& name) {
  const Reflection& r = *m.GetReflection();
  switch (f.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE: return r.AddDouble(&m, &f, number_in_unit(name, f, v));
    case FieldDescriptor::CPPTYPE_FLOAT: return r.AddFloat(&m, &f, static_cast<float>(number_in_unit(name, f, v)));
    case FieldDescriptor::CPPTYPE_INT32: return r.AddInt32(&m, &f, whole_number<std::int32_t>(name, f, v));
    case FieldDescriptor::CPPTYPE_INT64: return r.AddInt64(&m, &f, whole_number<std::int64_t>(name, f, v));
    case FieldDescriptor::CPPTYPE_UINT32: return r.AddUInt32(&m, &f, whole_number<std::uint32_t>(name, f, v));
    case FieldDescriptor::CPPTYPE_UINT64: return r.AddUInt64(&m, &f, whole_number<std::uint64_t>(name, f, v));
    case FieldDescriptor::CPPTYPE_BOOL: return r.AddBool(&m, &f, flag_of(name, f, v));
    case FieldDescriptor::CPPTYPE_ENUM: return r.AddEnumValue(&m, &f, enumerator_of(name, f, v));
    case FieldDescriptor::CPPTYPE_STRING: return r.AddString(&m, &f, text_of(name, f, v));
    case FieldDescriptor::CPPTYPE_MESSAGE: return parse_message(name, f, v, *r.AddMessage(&m, &f));
  }
}

Value element_value(const Message& m, const FieldDescriptor& f, int i) {
  const Reflection& r = *m.GetReflection();
  const bool many = i >= 0;
  Value value;
  switch (f.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      value.set_number(many ? r.GetRepeatedDouble(m, &f, i) : r.GetDouble(m, &f));
      break;
    case FieldDescriptor::CPPTYPE_FLOAT:
      value.set_number(many ? r.GetRepeatedFloat(m, &f, i) : r.GetFloat(m, &f));
      break;
    case FieldDescriptor::CPPTYPE_INT32:
      value.set_integer(many ? r.GetRepeatedInt32(m, &f, i) : r.GetInt32(m, &f));
      break;
    case FieldDescriptor::CPPTYPE_INT64:
      value.set_integer(many ? r.GetRepeatedInt64(m, &f, i) : r.GetInt64(m, &f));
      break;
    case FieldDescriptor::CPPTYPE_UINT32:
      value.set_integer(many ? r.GetRepeatedUInt32(m, &f, i) : r.GetUInt32(m, &f));
      break;
    case FieldDescriptor::CPPTYPE_UINT64:
      set_natural(value, many ? r.GetRepeatedUInt64(m, &f, i) : r.GetUInt64(m, &f));
      break;
    case FieldDescriptor::CPPTYPE_BOOL: value.set_flag(many ? r.GetRepeatedBool(m, &f, i) : r.GetBool(m, &f)); break;
    case FieldDescriptor::CPPTYPE_ENUM:
      value.set_text((many ? r.GetRepeatedEnum(m, &f, i) : r.GetEnum(m, &f))->name());
      break;
    case FieldDescriptor::CPPTYPE_STRING:
      value.set_text(readable_text(many ? r.GetRepeatedString(m, &f, i) : r.GetString(m, &f)));
      break;
    case FieldDescriptor::CPPTYPE_MESSAGE:
      value.set_message((many ? r.GetRepeatedMessage(m, &f, i) : r.GetMessage(m, &f)).ShortDebugString());
      break;
  }
  return value;
}

}  // namespace

void set_natural(Value& value, std::uint64_t number) {
  if (std::in_range<std::int64_t>(number)) return value.set_integer(static_cast<std::int64_t>(number));
  value.set_number(static_cast<double>(number));
  value.set_typed(std::to_string(number));
}

void merge_text(Message& message, const Value& value) {
  if (const auto expected = misread(value, message)) {
    const bool hidden = has_secrets(message.GetDescriptor());
    const std::string what = hidden ? "the text of the object" : "'" + value_text(value) + "'";
    throw Error(ErrorCode::Usage, {.what = what + " cannot be read", .expected = *expected});
  }
}

void set_field(Message& message, const FieldDescriptor& field, const Value& value, const std::string& name) {
  if (!field.is_repeated()) return set_single(message, field, value, name);
  message.GetReflection()->ClearField(&message, &field);
  if (value.kind_case() != Value::kList) return add_element(message, field, value, name);
  for (const auto& one : value.list().values()) add_element(message, field, one, name);
}

Value parse_default(const FieldDescriptor& field, const std::string& text) {
  Value value;
  if (field.cpp_type() == FieldDescriptor::CPPTYPE_STRING || field.cpp_type() == FieldDescriptor::CPPTYPE_ENUM) {
    value.set_text(text);
    return value;
  }
  if (field.cpp_type() == FieldDescriptor::CPPTYPE_BOOL && (text == "true" || text == "false")) {
    value.set_flag(text == "true");
    return value;
  }
  if (const auto integer = read_all<std::int64_t>(text)) {
    value.set_integer(*integer);
    return value;
  }
  if (const auto number = read_all<double>(text)) {
    value.set_number(*number);
    value.set_typed(text);
    return value;
  }
  throw Error(ErrorCode::Usage, {.what = "the declared default '" + text + "' is no " + type_text(field),
                                 .where = field.full_name(),
                                 .next = "correct (fiona.default_value) in " + field.file()->name()});
}

Value field_value(const Message& message, const FieldDescriptor& field) {
  if (!field.is_repeated()) return element_value(message, field, -1);
  Value value;
  auto& list = *value.mutable_list();
  const int count = message.GetReflection()->FieldSize(message, &field);
  for (int i = 0; i < count; ++i) *list.add_values() = element_value(message, field, i);
  return value;
}

std::string field_text(const Message& message, const FieldDescriptor& field) {
  return value_text(field_value(message, field));
}

std::string type_text(const FieldDescriptor& field) {
  std::string text = field.cpp_type() == FieldDescriptor::CPPTYPE_ENUM      ? "enum " + field.enum_type()->name()
                     : field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE ? field.message_type()->name()
                                                                            : field.type_name();
  return field.is_repeated() ? text + "[]" : text;
}

std::string range_text(const FieldDescriptor& field) {
  if (field.cpp_type() == FieldDescriptor::CPPTYPE_ENUM) return fmt::format("{}", fmt::join(enumerators(field), "|"));
  const auto& options = field.options();
  const bool has_min = options.HasExtension(fiona::min);
  const bool has_max = options.HasExtension(fiona::max);
  std::string text;
  if (has_min && has_max) {
    text = fmt::format("{} .. {}", options.GetExtension(fiona::min), options.GetExtension(fiona::max));
  } else if (has_min) {
    text = fmt::format("at least {}", options.GetExtension(fiona::min));
  } else if (has_max) {
    text = fmt::format("at most {}", options.GetExtension(fiona::max));
  }
  if (!options.HasExtension(fiona::step)) return text;
  return fmt::format("{}{}in steps of {}", text, text.empty() ? "" : ", ", options.GetExtension(fiona::step));
}

}  // namespace fiona::detail
