// A process that goes on without its host, and with the next one.
#include "names.hpp"
#include "runtime.hpp"

namespace fiona::host {
/// Processes outside have had their wires from it: they end with it.
void Runtime::host_lost(const std::string& endpoint) {
  const std::string reason = "the host has ended";
  links_.peer_lost(endpoint, endpoint, reason);
  links_.cut_attached(reason);
  taps_.clear();
}

void Runtime::tell_held(wire::Adopted& adopted) {
  for (const auto& [id, wire] : wires_) {
    auto& held = *adopted.add_wires();
    held.set_wire(id);
    *held.mutable_client() = port_named(wire.client->port().full_name());
    *held.mutable_provider() = port_named(wire.client->provider());
    held.set_prescale(wire.prescale);
    held.set_provider_end(true);
    held.set_client_end(true);
    held.set_open(true);
  }
  links_.add_held(adopted);
  status(*adopted.mutable_status());
}

}  // namespace fiona::host
