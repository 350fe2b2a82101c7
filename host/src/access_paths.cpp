// Which parameters name files of this machine: apart from the rest of the policy, for it looks at the model.
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "access.hpp"
#include "fiona/options.pb.h"
#include "model.hpp"

namespace fiona::host {
namespace {

using google::protobuf::FieldDescriptor;
/// Each with the parameter that names it.
using Paths = std::set<std::pair<std::string, std::string>>;

void add_paths(const google::protobuf::Message& object, const std::string& parameter, Paths& found);

/// Of one value of a field.
void add_paths(const google::protobuf::Message& object, const FieldDescriptor& field, int at,
               const std::string& parameter, Paths& found) {
  const auto& reflect = *object.GetReflection();
  const bool many = field.is_repeated();
  if (field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
    const auto& part = many ? reflect.GetRepeatedMessage(object, &field, at) : reflect.GetMessage(object, &field);
    return add_paths(part, parameter, found);
  }
  if (field.cpp_type() != FieldDescriptor::CPPTYPE_STRING || !field.options().GetExtension(fiona::host_path)) return;
  found.emplace(parameter, many ? reflect.GetRepeatedString(object, &field, at) : reflect.GetString(object, &field));
}

/// All that an object names on this machine, at whatever depth. `parameter`: whose part it is; empty: it is no part.
void add_paths(const google::protobuf::Message& object, const std::string& parameter, Paths& found) {
  const auto& reflect = *object.GetReflection();
  std::vector<const FieldDescriptor*> fields;
  reflect.ListFields(object, &fields);
  for (const FieldDescriptor* field : fields) {
    const int values = field->is_repeated() ? reflect.FieldSize(object, field) : 1;
    for (int at = 0; at < values; ++at)
      add_paths(object, *field, at, parameter.empty() ? field->name() : parameter, found);
  }
}

/// The parameters that name something on this machine, beyond what is the package's own.
Paths host_paths(const Model::Instance& one) {
  if (!one.parameters) return {};
  Paths found, own;
  add_paths(*one.parameters, "", found);
  add_paths(*one.default_parameters(), "", own);
  std::erase_if(found, [&own](const auto& path) { return path.second.empty() || own.contains(path); });
  return found;
}

}  // namespace

std::optional<Need> need_of(const Model& before, const Model& after) {
  for (const std::string& name : after.names()) {
    const Model::Instance& one = after.instance(name);
    const Model::Instance* was = before.find(name);
    if (was == &one) continue;
    const Paths known = was && was->source() == one.source() ? host_paths(*was) : Paths();
    for (const auto& path : host_paths(one)) {
      if (!known.contains(path))
        return Need{trust::Access::Administer, (was ? "set " + name + " " : "load with ") + path.first};
    }
  }
  return std::nullopt;
}

}  // namespace fiona::host
