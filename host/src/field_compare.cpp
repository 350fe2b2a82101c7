#include "field_compare.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <google/protobuf/descriptor.h>

#include <charconv>
#include <optional>

#include "fiona/error.hpp"
#include "fiona/options.pb.h"
#include "fiona/probe.pb.h"
#include "fiona/secrets.hpp"
#include "fiona/units.hpp"

namespace fiona::host {

using control::Value;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;

namespace {

struct Place {
  const Message* message;
  const FieldDescriptor* field;
  int index;  ///< -1: not an element
};

struct Step {
  std::string name;
  int index = -1;
};

/// "waypoints[2]" -> {"waypoints", 2}.
Step parse_step(const std::string& text, const std::string& path) {
  const std::size_t bracket = text.find('[');
  if (bracket == std::string::npos) return {text, -1};
  int index = -1;
  const char* begin = text.data() + bracket + 1;
  const char* end = text.data() + text.size() - 1;
  const bool closed = text.back() == ']' && begin < end;
  if (!closed || std::from_chars(begin, end, index).ptr != end || index < 0) {
    throw Error(ErrorCode::Usage,
                {.what = "'" + text + "' is no element", .where = path, .expected = "field[0], field[1], …"});
  }
  return {text.substr(0, bracket), index};
}

Place resolve(const Message& message, const Step& step, const std::string& path) {
  const auto& type = *message.GetDescriptor();
  const FieldDescriptor* field = type.FindFieldByName(step.name);
  if (!field) {
    std::vector<std::string> known;
    for (int i = 0; i < type.field_count(); ++i) known.push_back(type.field(i)->name());
    throw Error(ErrorCode::NotFound, {.what = type.full_name() + " has no field '" + step.name + "'",
                                      .where = path,
                                      .expected = fmt::format("one of {}", fmt::join(known, ", ")),
                                      .near = nearest_names(step.name, known)});
  }
  if (is_secret(*field)) {
    throw Error(ErrorCode::NotAllowed, {.what = "'" + step.name + "' is secret: it is neither shown nor compared",
                                        .where = path,
                                        .next = "compare another field"});
  }
  if (field->is_repeated() != (step.index >= 0)) {
    throw Error(ErrorCode::Usage,
                {.what = "'" + step.name + (field->is_repeated() ? "' is a list: name an element" : "' is no list"),
                 .where = path,
                 .expected = field->is_repeated() ? step.name + "[0]" : step.name});
  }
  return {&message, field, step.index};
}

/// The place that a path leads to; none when a list on the way is too short.
std::optional<Place> locate(const Message& root, const std::string& path) {
  const Message* message = &root;
  std::size_t begin = 0;
  while (true) {
    const std::size_t dot = path.find('.', begin);
    const Place place =
        resolve(*message, parse_step(path.substr(begin, dot == std::string::npos ? dot : dot - begin), path), path);
    const Reflection& reflect = *message->GetReflection();
    if (place.index >= 0 && place.index >= reflect.FieldSize(*message, place.field)) return std::nullopt;
    if (dot == std::string::npos) return place;
    if (place.field->cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE) {
      throw Error(ErrorCode::Usage, {.what = "'" + place.field->name() + "' has no fields of its own",
                                     .where = path,
                                     .next = "compare " + path.substr(0, dot) + " itself"});
    }
    message = place.index >= 0 ? &reflect.GetRepeatedMessage(*message, place.field, place.index)
                               : &reflect.GetMessage(*message, place.field);
    begin = dot + 1;
  }
}

template <class T>
bool holds(control::Comparison comparison, const T& a, const T& b) {
  switch (comparison) {
    case control::EQUAL: return a == b;
    case control::NOT_EQUAL: return a != b;
    case control::LESS: return a < b;
    case control::LESS_OR_EQUAL: return a <= b;
    case control::GREATER: return a > b;
    case control::GREATER_OR_EQUAL: return a >= b;
    default: return false;
  }
}

std::optional<double> number_at(const Place& p) {
  const Reflection& r = *p.message->GetReflection();
  const Message& m = *p.message;
  const bool many = p.index >= 0;
  switch (p.field->cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return many ? r.GetRepeatedDouble(m, p.field, p.index) : r.GetDouble(m, p.field);
    case FieldDescriptor::CPPTYPE_FLOAT: return many ? r.GetRepeatedFloat(m, p.field, p.index) : r.GetFloat(m, p.field);
    case FieldDescriptor::CPPTYPE_INT32: return many ? r.GetRepeatedInt32(m, p.field, p.index) : r.GetInt32(m, p.field);
    case FieldDescriptor::CPPTYPE_UINT32:
      return many ? r.GetRepeatedUInt32(m, p.field, p.index) : r.GetUInt32(m, p.field);
    case FieldDescriptor::CPPTYPE_INT64:
      return static_cast<double>(many ? r.GetRepeatedInt64(m, p.field, p.index) : r.GetInt64(m, p.field));
    case FieldDescriptor::CPPTYPE_UINT64:
      return static_cast<double>(many ? r.GetRepeatedUInt64(m, p.field, p.index) : r.GetUInt64(m, p.field));
    default: return std::nullopt;
  }
}

/// A word, or a number or flag as it was typed; none if the value is neither.
std::optional<std::string> text_of(const Value& value) {
  if (value.kind_case() == Value::kText) return value.text();
  return value.typed().empty() ? std::nullopt : std::optional(value.typed());
}

[[noreturn]] void refuse(const Place& place, const std::string& expected) {
  throw Error(ErrorCode::Usage,
              {.what = "'" + place.field->name() + "' does not compare with this value", .expected = expected});
}

std::pair<bool, std::string> compare_number(const Place& place, double number, control::Comparison comparison,
                                            const Value& value, const std::string& unit_of_probe) {
  if (value.kind_case() != Value::kNumber && value.kind_case() != Value::kInteger) refuse(place, "a number");
  double typed = value.kind_case() == Value::kNumber ? value.number() : static_cast<double>(value.integer());
  if (!value.unit().empty()) {
    const std::string& declared = place.field->options().GetExtension(fiona::unit);
    const std::string& unit = declared.empty() ? unit_of_probe : declared;
    const auto conversion = convert_unit(value.unit(), unit);
    if (!conversion) refuse(place, unit.empty() ? "a number without unit" : "a number in " + unit);
    typed = typed * conversion->factor + conversion->offset;
  }
  return {holds(comparison, number, typed), fmt::format("{}", number)};
}

}  // namespace

std::pair<bool, std::string> compare_field(const Message& object, const std::string& path,
                                           control::Comparison comparison, const Value& value,
                                           const std::string& unit) {
  const bool is_plain = object.GetDescriptor()->file() == probe::Number::descriptor()->file();
  if (path.empty() && !is_plain) {
    std::vector<std::string> fields;
    for (int i = 0; i < object.GetDescriptor()->field_count(); ++i)
      fields.push_back(object.GetDescriptor()->field(i)->name());
    throw Error(ErrorCode::Usage, {.what = "a " + object.GetDescriptor()->name() + " compares by a field of it",
                                   .expected = fmt::format("one of {}", fmt::join(fields, ", "))});
  }
  if (!path.empty() && is_plain)
    throw Error(ErrorCode::NotFound,
                {.what = "the probe is no object: it has no field '" + path + "'", .next = "compare the probe itself"});
  const auto place = locate(object, is_plain ? "value" : path);
  if (!place) return {false, "the list is shorter"};
  const Reflection& reflect = *place->message->GetReflection();
  if (place->field->has_presence() && place->index < 0 && !reflect.HasField(*place->message, place->field)) {
    return {false, "not set"};
  }
  if (const auto number = number_at(*place))
    return compare_number(*place, *number, comparison, value, is_plain ? unit : "");
  if (place->index >= 0) refuse(*place, "an element that is a number");
  switch (place->field->cpp_type()) {
    case FieldDescriptor::CPPTYPE_BOOL: {
      if (value.kind_case() != Value::kFlag) refuse(*place, "true or false");
      const bool flag = reflect.GetBool(*place->message, place->field);
      return {holds(comparison, flag, value.flag()), flag ? "true" : "false"};
    }
    case FieldDescriptor::CPPTYPE_STRING: {
      const auto typed = text_of(value);
      if (!typed) refuse(*place, "a word or a quoted string");
      const std::string text = reflect.GetString(*place->message, place->field);
      return {holds(comparison, text, *typed), text};
    }
    case FieldDescriptor::CPPTYPE_ENUM: {
      if (value.kind_case() != Value::kText) refuse(*place, "the name of an enumerator");
      const std::string name = reflect.GetEnum(*place->message, place->field)->name();
      return {holds(comparison, name, value.text()), name};
    }
    default: refuse(*place, "a field that is a number, a flag, a word or an enumerator");
  }
}

}  // namespace fiona::host
