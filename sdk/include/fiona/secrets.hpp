#pragma once

#include <memory>
#include <optional>
#include <string>

#include "fiona/service.hpp"

namespace fiona {

/// Fields that are marked `(fiona.secret)`: passwords, sessions. Whatever shows, logs, keeps or records an object does
/// so without them; a port's own consumers get them. All functions [any thread].
bool is_secret(const google::protobuf::FieldDescriptor& field);

/// The first one that objects of the type can have, at any depth ("user.password"); none: they may be shown as they
/// are.
std::optional<std::string> first_secret(const google::protobuf::Descriptor& type);

/// An object without its secrets: itself, or where its type has such fields a copy that has none of them set. Lives no
/// longer than the object.
class WithoutSecrets {
 public:
  explicit WithoutSecrets(const Object& object);

  const Object& operator*() const { return copy_ ? *copy_ : object_; }
  const Object* operator->() const { return &**this; }

 private:
  const Object& object_;
  std::unique_ptr<Object> copy_;
};

}  // namespace fiona
