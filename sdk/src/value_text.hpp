#pragma once

#include <google/protobuf/message.h>

#include <string>

#include "fiona/control.pb.h"

namespace fiona::detail {

/// Sets one field from a value as typed, converting its unit. Throws Error naming `name`, the value and what would
/// have been right.
void set_field(google::protobuf::Message& message, const google::protobuf::FieldDescriptor& field,
               const control::Value& value, const std::string& name);

/// Sets those fields of `message` that protobuf text in braces names. Throws Error naming the value and the mistake.
void merge_text(google::protobuf::Message& message, const control::Value& value);

/// The value that `(fiona.default_value)` spells. Throws Error naming the field.
control::Value parse_default(const google::protobuf::FieldDescriptor& field, const std::string& text);

/// The field as a value that sets it, and as the console would type that.
control::Value field_value(const google::protobuf::Message& message, const google::protobuf::FieldDescriptor& field);
std::string field_text(const google::protobuf::Message& message, const google::protobuf::FieldDescriptor& field);

/// "double", "string[]", "enum Delivery"; and "0.1 .. 1", "UP|DOWN", "" without rule.
std::string type_text(const google::protobuf::FieldDescriptor& field);
std::string range_text(const google::protobuf::FieldDescriptor& field);

}  // namespace fiona::detail
