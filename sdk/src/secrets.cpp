#include "fiona/secrets.hpp"

#include <google/protobuf/descriptor.h>

#include <algorithm>
#include <vector>

namespace fiona {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;

namespace {

bool is_message(const FieldDescriptor& field) { return field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE; }

/// `seen`: the types that have been looked through, since types have each other and themselves.
std::optional<std::string> first_secret(const Descriptor& type, std::vector<const Descriptor*>& seen) {
  if (std::find(seen.begin(), seen.end(), &type) != seen.end()) return std::nullopt;
  seen.push_back(&type);
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (is_secret(field)) return field.name();
    const auto below = is_message(field) ? first_secret(*field.message_type(), seen) : std::nullopt;
    if (below) return field.name() + "." + *below;
  }
  return std::nullopt;
}

void clear_secrets(Object& object) {
  const Descriptor& type = *object.GetDescriptor();
  const auto& reflect = *object.GetReflection();
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (is_secret(field)) {
      reflect.ClearField(&object, &field);
    } else if (is_message(field) && field.is_repeated()) {
      for (int k = 0; k < reflect.FieldSize(object, &field); ++k)
        clear_secrets(*reflect.MutableRepeatedMessage(&object, &field, k));
    } else if (is_message(field) && reflect.HasField(object, &field)) {
      clear_secrets(*reflect.MutableMessage(&object, &field));
    }
  }
}

}  // namespace

bool is_secret(const FieldDescriptor& field) { return field.options().GetExtension(fiona::secret); }

std::optional<std::string> first_secret(const Descriptor& type) {
  std::vector<const Descriptor*> seen;
  return first_secret(type, seen);
}

WithoutSecrets::WithoutSecrets(const Object& object) : object_(object) {
  if (!first_secret(*object.GetDescriptor())) return;
  copy_.reset(object.New());
  copy_->CopyFrom(object);
  clear_secrets(*copy_);
}

}  // namespace fiona
