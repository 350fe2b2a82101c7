#include "attachments.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "fiona/error.hpp"
#include "link_keys.hpp"
#include "os/process.hpp"
#include "types.hpp"

namespace fiona::host {
namespace {

/// Wires that one connection may hold.
constexpr std::ptrdiff_t kMostAttached = 64;

std::uint32_t major_of(std::uint32_t number) { return std::max(1U, number); }

/// The client has no descriptor that could be compared: it says which version it was written for.
void require_speaks(const control::Attach& request, const std::string& service, const ServiceContract& contract) {
  const bool fits = request.service() == service && major_of(request.major()) == major_of(contract.major()) &&
                    request.minor() <= contract.minor();
  if (fits) return;
  const auto text = [](const std::string& name, std::uint32_t major, std::uint32_t minor) {
    return fmt::format("{} {}.{}", name, major_of(major), minor);
  };
  throw Error(ErrorCode::WiringInvalid,
              {.what = fmt::format("the client speaks another service than {}", text_of(request.provider())),
               .where = text_of(request.provider()),
               .expected = text(service, contract.major(), contract.minor()) + ", or an older minor version",
               .found = text(request.service(), request.major(), request.minor())});
}

}  // namespace

ServiceContract contract_for(const control::Attach& request, const Model& model) {
  require_name(request.client(), "a client");
  const control::PortName& provider = request.provider();
  const Model::Instance& instance = model.instance(provider.instance());
  const std::string& speaks = model.port(provider, PROVIDES).service();
  model.require_own(provider.instance());
  const auto* service = Types::service(*instance.package->types, speaks);
  if (!service) {
    throw Error(ErrorCode::WiringInvalid,
                {.what = text_of(provider) + " speaks " + speaks + ", which is unknown to the host",
                 .next = "describe the service in the package: plugin check tells how"});
  }
  ServiceContract contract = ServiceInfo(*service).contract();
  require_speaks(request, speaks, contract);
  return contract;
}

void Attachments::require_room(std::uint64_t owner) const {
  const auto held = std::count_if(attachments_.begin(), attachments_.end(),
                                  [owner](const auto& one) { return one.second.owner == owner; });
  if (held >= kMostAttached) {
    throw Error(ErrorCode::NotAllowed,
                {.what = fmt::format("this connection holds {} wires already", held), .next = "detach one"});
  }
}

control::Attached Attachments::open(std::uint64_t owner, const control::Attach& request,
                                    const ServiceContract& contract, Group& group, std::uint64_t wire) {
  const control::PortName& provider = request.provider();
  Attachment made{owner, fmt::format("client:{}:{}", owner, request.client()), provider, group.name(), {}};
  made.client.set_name(request.client());
  made.client.set_prescale(std::max(1U, request.prescale()));
  control::Attached attached;
  attached.set_endpoint(group.endpoint());
  attached.set_peer(made.peer);
  attached.set_key(link_key(group.link_key(), made.peer));
  attached.set_wire(wire);
  attached.set_token(os::random_token());
  *attached.mutable_contract() = contract;
  wire::GroupRequest grant;
  auto& provide = *grant.mutable_wire_provide();
  provide.set_wire(wire);
  provide.set_token(attached.token());
  *provide.mutable_provider() = provider;
  provide.set_prescale(made.client.prescale());
  provide.set_peer(made.peer);
  provide.mutable_client()->set_instance(request.client());
  provide.set_attached(true);
  group.request(std::move(grant));
  attachments_.emplace(wire, std::move(made));
  return attached;
}

void Attachments::detach(std::uint64_t owner, std::uint64_t wire) {
  const auto found = attachments_.find(wire);
  if (found == attachments_.end() || found->second.owner != owner) {
    throw Error(ErrorCode::NotFound, {.what = fmt::format("this connection holds no wire {}", wire),
                                      .next = "detach what was attached over it"});
  }
  groups_.cut(found->second.group, wire, "detached");
  end(wire);
}

void Attachments::detach_all(std::uint64_t owner) {
  std::vector<std::uint64_t> wires;
  for (const auto& [wire, one] : attachments_) {
    if (one.owner == owner) wires.push_back(wire);
  }
  for (const std::uint64_t wire : wires) end(wire);
}

/// What is left at a provider goes with the links.
void Attachments::end(std::uint64_t wire) {
  const auto found = attachments_.find(wire);
  if (found == attachments_.end()) return;
  wire::PeerLost gone;
  gone.set_name(found->second.peer);
  gone.set_reason(fmt::format("client '{}' has gone", found->second.client.name()));
  attachments_.erase(found);
  const bool has_others = std::any_of(attachments_.begin(), attachments_.end(),
                                      [&gone](const auto& one) { return one.second.peer == gone.name(); });
  if (!has_others) groups_.tell_lost(gone);
}

void Attachments::lose(const std::string& group, const std::string& reason) {
  for (const auto& [wire, one] : attachments_) {
    if (one.group == group) tell_lost(wire, reason);
  }
}

void Attachments::lose_to(const std::string& instance) {
  for (const auto& [wire, one] : attachments_) {
    if (one.provider.instance() != instance) continue;
    groups_.cut(one.group, wire, "another version serves");
    tell_lost(wire, "another version of '" + instance + "' serves: attach again");
  }
}

void Attachments::tell_lost(std::uint64_t wire, const std::string& reason) const {
  wire::GroupMessage event;
  event.mutable_wire_lost()->set_wire(wire);
  event.mutable_wire_lost()->set_reason(reason);
  on_event_(event);
}

std::size_t Attachments::clients() const {
  std::set<std::string> names;
  for (const auto& [wire, one] : attachments_) names.insert(one.peer);
  return names.size();
}

void Attachments::add_clients(const std::string& instance, control::PortStatus& port) const {
  for (const auto& [wire, one] : attachments_) {
    if (one.provider.instance() == instance && one.provider.port() == port.name()) *port.add_attached() = one.client;
  }
}

}  // namespace fiona::host
