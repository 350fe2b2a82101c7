// Which parameters name files of this machine: apart from the rest of the policy, for it looks at the model.
#include <algorithm>
#include <vector>

#include "access.hpp"
#include "fiona/options.pb.h"
#include "fiona/params.hpp"
#include "model.hpp"

namespace fiona::host {
namespace {

/// The parameters that name something on this machine, beyond what is the package's own.
std::vector<control::Argument> host_paths(const Model::Instance& one) {
  if (!one.parameters) return {};
  auto found = differences(*one.parameters, *one.default_parameters());
  std::erase_if(found, [&one](const control::Argument& argument) {
    const auto* field = one.parameters->GetDescriptor()->FindFieldByName(argument.name());
    return !field || !field->options().GetExtension(fiona::host_path) || argument.value().text().empty();
  });
  return found;
}

}  // namespace

std::optional<Need> need_of(const Model& before, const Model& after) {
  for (const std::string& name : after.names()) {
    const Model::Instance& one = after.instance(name);
    const Model::Instance* was = before.find(name);
    if (was == &one) continue;
    const auto known = was && was->source() == one.source() ? host_paths(*was) : std::vector<control::Argument>();
    for (const auto& path : host_paths(one)) {
      const bool is_known = std::any_of(known.begin(), known.end(), [&path](const auto& other) {
        return other.name() == path.name() && other.value().text() == path.value().text();
      });
      if (!is_known) return Need{trust::Access::Administer, (was ? "set " + name + " " : "load with ") + path.name()};
    }
  }
  return std::nullopt;
}

}  // namespace fiona::host
