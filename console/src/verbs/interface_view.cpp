#include "interface_view.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "../system_view.hpp"

#include "fiona/options.pb.h"

namespace fiona::console::verbs {
namespace {

std::string pattern_of(const TypeSet& types, const std::string& service) {
  const auto* found = types.service(service);
  return found == nullptr ? "" : pattern_text(found->options().GetExtension(fiona::contract).pattern());
}

/// The objects that a service carries, each once over all the ports.
void add_objects(const TypeSet& types, const std::string& service,
                 std::vector<const google::protobuf::Descriptor*>& objects) {
  const auto* found = types.service(service);
  for (int i = 0; found != nullptr && i < found->method_count(); ++i) {
    for (const auto* type : {found->method(i)->input_type(), found->method(i)->output_type()}) {
      if (type->full_name() != "fiona.None" && std::find(objects.begin(), objects.end(), type) == objects.end())
        objects.push_back(type);
    }
  }
}

}  // namespace

void show_component(Session& session, const fiona::ComponentInterface& component, const TypeSet& types) {
  session.out.text(fmt::format("\n{}  {}", component.name(), component.doc()));
  Table ports({"port", "direction", "service", "pattern", "doc"});
  std::vector<const google::protobuf::Descriptor*> objects;
  for (const auto& port : component.ports()) {
    ports.add({port.name(),
               port.direction() == PROVIDES ? "provides"
               : port.optional()            ? "requires, optional"
                                            : "requires",
               short_name(port.service()), pattern_of(types, port.service()), port.doc()});
    add_objects(types, port.service(), objects);
  }
  session.out.table(ports, "it has no ports");
  if (const auto* parameters = component.parameters().empty() ? nullptr : types.object(component.parameters())) {
    session.out.text(fmt::format("\nparameters of {}", component.name()));
    session.out.table(field_table(*parameters), "");
  }
  for (const auto* object : objects) {
    session.out.text("\n" + object->full_name());
    session.out.table(field_table(*object), "it has no fields");
  }
}

}  // namespace fiona::console::verbs
