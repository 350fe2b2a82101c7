// Looking at ports and probes: what is tapped, read, or waited for.
#include <algorithm>

#include "fiona/error.hpp"
#include "fiona/hull_probes.hpp"
#include "system.hpp"

namespace fiona::host {

void System::tap(std::uint64_t id, const control::Watch& request, bool is_own) {
  const control::PortName& name = request.port();
  control::PortName target = name;
  if (model_.wire_of(name) && model_.find(served_by(name).instance())) target = served_by(name);
  const auto& ports = model_.instance(target.instance()).interface().ports();
  const bool unwired = std::any_of(ports.begin(), ports.end(), [&](const PortInterface& p) {
    return p.name() == target.port() && p.direction() == REQUIRES;
  });
  if (unwired) {
    throw Error(ErrorCode::Usage, {.what = text_of(name) + " has no wire: nothing comes to it", .next = "spots"});
  }
  control::Watch watch = request;
  *watch.mutable_port() = target;
  taps_.open(group_of(target.instance(), model_), id, watch, is_own);
}

wire::Tapped System::read(const control::PortName& name) {
  wire::GroupRequest request;
  *request.mutable_read()->mutable_probe() = name;
  return group_of(name.instance(), model_).request(std::move(request)).tapped();
}

control::Expect System::expected(control::Expect request) {
  control::PortName& name = *request.mutable_port();
  const Model::Instance& owner = model_.instance(name.instance());
  const auto& component = owner.interface();
  const auto probes = hull_probes();
  const auto has = [&](HullProbe::Of of) {
    return std::any_of(probes.begin(), probes.end(),
                       [&](const auto& one) { return one.of == of && one.name == request.field(); });
  };
  const auto named = [&name](const auto& one) { return one.name() == name.port(); };
  const auto port = std::find_if(component.ports().begin(), component.ports().end(), named);
  const bool is_task = std::any_of(component.tasks().begin(), component.tasks().end(), named);
  const auto* service =
      port == component.ports().end() ? nullptr : Types::service(*owner.package->types, port->service());
  const bool is_field = service && ServiceInfo(*service).object().FindFieldByName(request.field());
  if (service && request.field().empty()) {
    throw Error(ErrorCode::Usage,
                {.what = text_of(name) + " is a port: '" + text_of(name) + "' names no field of its object",
                 .expected = "INSTANCE.PORT.FIELD",
                 .next = "show " + text_of(name)});
  }
  if ((service && has(HullProbe::Of::Port) && !is_field) || (is_task && has(HullProbe::Of::Task))) {
    name.set_port(name.port() + "." + request.field());
    request.clear_field();
  }
  return request;
}

}  // namespace fiona::host
