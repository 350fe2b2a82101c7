#include "connector.hpp"

#include "fiona/error.hpp"
#include "link_keys.hpp"
#include "orders.hpp"
#include "os/process.hpp"

namespace fiona::host {
namespace {

wire::GroupRequest local_wire(std::uint64_t id, const control::PortName& client, const control::PortName& provider,
                              std::uint32_t prescale, std::uint64_t replaces) {
  wire::GroupRequest request;
  auto& local = *request.mutable_wire_local();
  local.set_wire(id);
  *local.mutable_client() = client;
  *local.mutable_provider() = provider;
  local.set_prescale(prescale);
  local.set_replaces(replaces);
  return request;
}

/// The provider's part of a wire between processes. `peer`: whose link brings it.
wire::GroupRequest provided_wire(const wire::WireRequire& client_part, std::uint32_t prescale,
                                 const std::string& peer) {
  wire::GroupRequest request;
  auto& provide = *request.mutable_wire_provide();
  provide.set_wire(client_part.wire());
  provide.set_token(client_part.token());
  *provide.mutable_provider() = client_part.provider();
  *provide.mutable_client() = client_part.client();
  provide.set_prescale(prescale);
  provide.set_peer(peer);
  return request;
}

/// At the client, while its provider may still be at the grant: why that is not given tells more than that nothing
/// opened.
wire::GroupMessage open(Group& client, wire::GroupRequest request, const std::function<void()>& granted) {
  wire::GroupMessage reply;
  try {
    reply = client.request(std::move(request));
  } catch (const Error&) {
    granted();
    throw;
  }
  try {
    granted();
  } catch (const Error&) {  // it was, or nothing would be open: its process has only not said so yet
  }
  return reply;
}

}  // namespace

Connector::Wire Connector::connect(const control::PortName& client, const control::PortName& provider,
                                   const Model& model, std::uint64_t replaces, control::Done& done, bool resumes) {
  const std::uint32_t prescale = model.wire_of(client)->prescale;
  Group& client_group = around_.group_of(client.instance(), model);
  Group& provider_group = around_.group_of(provider.instance(), model);
  Wire wire{provider, new_number(), &client_group == &provider_group, {}, {}};
  wire::GroupMessage reply;
  if (wire.local) {
    reply = client_group.request(local_wire(wire.id, client, provider, prescale, replaces));
  } else {
    wire::WireRequire require;
    require.set_wire(wire.id);
    *require.mutable_client() = client;
    *require.mutable_provider() = provider;
    require.set_replaces(replaces);
    if (resumes) require.set_resumes_every(prescale);
    const auto path = way(client_group, provider_group);
    const bool ahead = path.size() == 2;
    try {
      reply = open_along(path, require, prescale, ahead, wire.relays);
    } catch (const Error& error) {
      if (!ahead || error.code() != ErrorCode::Unreachable) throw;
      require.set_wire(wire.id = new_number());  // the provider is slow, or gone: now the one after the other
      reply = open_along(path, std::move(require), prescale, false, wire.relays);
    }
  }
  if (replaces != 0) add_cost(done, reply.switched(), 1);
  return wire;
}

/// The provider first, the client last: what is opened finds somebody who knows its token, or, `ahead`, will soon.
/// Notes who relays it.
wire::GroupMessage Connector::open_along(const std::vector<Group*>& path, wire::WireRequire require,
                                         std::uint32_t prescale, bool ahead, std::vector<std::string>& relays) {
  Group& client_group = *path.front();
  Group& provider_group = *path.back();
  require.set_token(os::random_token());
  require.set_ahead(ahead);
  const auto granted =
      provider_group.begin(provided_wire(require, prescale, known_as(*path[path.size() - 2], provider_group)));
  try {
    if (!ahead) granted();
    for (std::size_t i = path.size() - 2; i > 0; --i) {
      relays.push_back(path[i]->name());
      wire::GroupRequest request;
      auto& relay = *request.mutable_wire_relay();
      relay.set_wire(require.wire());
      relay.set_token(require.token());
      relay.set_peer(known_as(*path[i - 1], *path[i]));
      set_endpoint(relay, endpoint_for(*path[i], *path[i + 1]));
      path[i]->request(std::move(request));
    }
    set_endpoint(require, endpoint_for(client_group, *path[1]));
    wire::GroupRequest request;
    *request.mutable_wire_require() = require;
    return open(client_group, std::move(request), granted);
  } catch (...) {
    for (const auto& relay : relays) around_.groups.cut(relay, require.wire(), "the wire did not open");
    around_.groups.cut(provider_group.name(), require.wire(), "the wire did not open");
    throw;
  }
}

void Connector::add_cost(control::Done& done, const wire::Switched& switched, std::uint32_t wires) {
  done.set_switched(done.switched() + wires);
  done.set_gap_ms(std::max(done.gap_ms(), static_cast<double>(switched.gap_ns()) / 1e6));
  done.set_lost(done.lost() + switched.lost());
  done.set_redirected(done.redirected() + switched.redirected());
}

void Connector::disconnect(const control::PortName& client, const Wire& wire, const std::string& reason) {
  if (wire.id == 0) return;
  // The client first: told by its host it is unwired; told by the provider it would be lost.
  if (const auto* one = around_.model.find(client.instance())) around_.groups.cut(one->group, wire.id, reason);
  if (wire.local) return;
  try {
    if (const auto* one = around_.model.find(wire.provider.instance())) around_.groups.cut(one->group, wire.id, reason);
  } catch (const Error&) {  // it hangs, and has been told: it cuts its end when it goes on; the client is not held up
  }
  for (const auto& relay : wire.relays) around_.groups.cut(relay, wire.id, reason);
}

/// The processes that a wire goes through, from its client to its provider. One connection carries all that goes
/// between two hosts; their groups reach it through their host's own process.
std::vector<Group*> Connector::way(Group& client, Group& provider) const {
  const std::string from = around_.host_of(client.name());
  const std::string to = around_.host_of(provider.name());
  std::vector<Group*> path{&client};
  const auto go_by = [&path](Group& next) {
    if (path.back() != &next) path.push_back(&next);
  };
  if (from != to) go_by(around_.main_of(from));
  if (from != to && !from.empty() && !to.empty()) go_by(around_.main_of(""));
  if (from != to) go_by(around_.main_of(to));
  go_by(provider);
  return path;
}

/// How the process `at` knows who opens a link to it.
std::string Connector::known_as(const Group& who, const Group& at) const {
  const std::string host = around_.host_of(who.name());
  if (host == around_.host_of(at.name())) return who.link_name();
  return around_.host_of(at.name()).empty() ? std::string(kLeaderEndpoint) + host : std::string(kLeaderEndpoint);
}

/// Where `at` finds `to`, and what opens the link. A host that is led knows that of its own processes itself.
Links::Endpoint Connector::endpoint_for(const Group& at, const Group& to) const {
  const std::string host = around_.host_of(to.name());
  if (host != around_.host_of(at.name())) return {known_as(to, at), "", ""};
  if (!host.empty()) return {to.endpoint(), "", ""};
  return {to.endpoint(), at.link_name(), link_key(to.link_key(), at.link_name())};
}

}  // namespace fiona::host
