// Wires as they are meant to be: whose ports fit, to which providers.
#include <fmt/format.h>

#include <algorithm>

#include "fiona/contract.hpp"
#include "fiona/error.hpp"
#include "fiona/service.hpp"
#include "model.hpp"

namespace fiona::host {
namespace {

/// The longest hold time of a wire with alternatives.
constexpr double kMostHold_ms = 3'600'000;

/// "LocationProvider (push timed, CommLocation)".
std::string service_text(const google::protobuf::ServiceDescriptor* service, const std::string& full_name) {
  if (!service) return last_part(full_name);
  const ServiceInfo info(*service);
  const std::string answer = info.answer() ? " -> " + info.answer()->name() : "";
  return fmt::format("{} ({}, {}{})", service->name(), to_string(info.pattern()), info.object().name(), answer);
}

void check_alternatives(const control::Wire& request, const Model::Wire& made) {
  const std::string client = text_of(request.client());
  for (auto one = made.providers.begin(); one != made.providers.end(); ++one) {
    const auto same = [&](const auto& other) { return key_of(other) == key_of(*one); };
    if (std::none_of(made.providers.begin(), one, same)) continue;
    throw Error(ErrorCode::Usage, {.what = text_of(*one) + " is named twice",
                                   .where = client,
                                   .expected = "each alternative once, the best first"});
  }
  if (!request.has_hold_ms()) return;
  if (made.providers.size() == 1) {
    throw Error(ErrorCode::Usage,
                {.what = "a hold time is for a wire with alternatives",
                 .where = client,
                 .next = fmt::format("wire {} to {} else OTHER.PORT hold=…", client, text_of(request.provider()))});
  }
  if (made.hold_ms >= 0 && made.hold_ms <= kMostHold_ms) return;
  throw Error(ErrorCode::Usage, {.what = "the hold time is out of range",
                                 .where = client,
                                 .expected = "0s .. 1h",
                                 .found = fmt::format("{:g} ms", made.hold_ms)});
}

}  // namespace

bool Model::Wire::uses(const std::string& instance) const {
  return std::any_of(providers.begin(), providers.end(), [&](const auto& one) { return one.instance() == instance; });
}

bool Model::Wire::operator==(const Wire& other) const {
  const auto same = [](const auto& a, const auto& b) { return key_of(a) == key_of(b); };
  return std::equal(providers.begin(), providers.end(), other.providers.begin(), other.providers.end(), same) &&
         prescale == other.prescale && hold_ms == other.hold_ms;
}

control::Change Model::Wire::change_for(const PortKey& client, const Wire* before) const {
  control::Change change;
  control::Wire& request = *change.mutable_wire();
  *request.mutable_client() = port_of(client);
  *request.mutable_provider() = providers.front();
  request.mutable_alternatives()->Add(providers.begin() + 1, providers.end());
  // What is not named stays as it is.
  if (prescale != (before ? before->prescale : 1)) request.set_prescale(prescale);
  if (providers.size() > 1 && hold_ms != (before ? before->hold_ms : kHold_ms)) request.set_hold_ms(hold_ms);
  return change;
}

const Model::Wire* Model::wire_of(const control::PortName& client) const {
  const auto found = wires_.find(key_of(client));
  return found == wires_.end() ? nullptr : &found->second;
}

void Model::wire(const control::Wire& request) {
  port(request.client(), REQUIRES);
  require_own(request.client().instance());
  // The subscription is the port's: it survives its provider.
  Wire made = wire_of(request.client()) ? *wire_of(request.client()) : Wire{};
  made.providers.assign(1, request.provider());
  made.providers.insert(made.providers.end(), request.alternatives().begin(), request.alternatives().end());
  if (request.prescale() > 0) made.prescale = request.prescale();
  if (made.providers.size() == 1) made.hold_ms = Wire::kHold_ms;
  if (request.has_hold_ms()) made.hold_ms = request.hold_ms();
  check_alternatives(request, made);
  for (const auto& provider : made.providers) {
    require_own(provider.instance());
    if (find(provider.instance())) {
      require_fit(request.client(), provider);
    } else {
      require_name(provider.instance(), "an instance");
    }
  }
  wires_[key_of(request.client())] = std::move(made);
}

void Model::unwire(const control::Unwire& request) {
  port(request.client(), REQUIRES);
  require_own(request.client().instance());
  if (wires_.erase(key_of(request.client())) == 1) return;
  const std::string name = text_of(request.client());
  throw Error(ErrorCode::NotFound, {.what = name + " has no wire", .where = name, .next = "ls wires"});
}

void Model::require_fit(const control::PortName& client, const control::PortName& provider) const {
  const PortInterface& required = port(client, REQUIRES);
  const PortInterface& provided = port(provider, PROVIDES);
  const auto* a = Types::service(*instance(client.instance()).package->types, required.service());
  const auto* b = Types::service(*instance(provider.instance()).package->types, provided.service());
  const auto difference =
      a && b ? contract_difference(*a, *b) : std::optional<std::string>("a service is unknown to the host");
  if (!difference) return;
  const std::string fitting = providers_of(required.service());
  const std::string name = last_part(required.service());
  throw Error(
      ErrorCode::WiringInvalid,
      {.what = fmt::format("{} requires {}; {} provides {}", text_of(client), service_text(a, required.service()),
                           text_of(provider), service_text(b, provided.service())),
       .found = required.service() == provided.service() ? *difference : "",
       .next = fitting.empty() ? "nothing here provides " + name + ": spots shows who could"
                               : "these provide " + name + ": " + fitting});
}

bool Model::keeps_out(const PortKey& client, const Wire& wire) const {
  return std::any_of(wire.providers.begin(), wire.providers.end(), [&](const auto& provider) {
    if (!find(provider.instance())) return false;
    try {
      require_fit(port_of(client), provider);
      return false;
    } catch (const Error&) {
      return true;
    }
  });
}

std::string Model::providers_of(const std::string& service) const {
  std::vector<std::string> names;
  for (const auto& [name, one] : instances_) {
    for (const auto& p : one->interface().ports()) {
      if (p.direction() == PROVIDES && p.service() == service) names.push_back(name + "." + p.name());
    }
  }
  return fmt::format("{}", fmt::join(names, ", "));
}

}  // namespace fiona::host
