#include "runtime.hpp"

#include "failure.hpp"
#include "fiona/error.hpp"

namespace fiona::host {

Runtime::Runtime(Pool& pool, Clock& clock, PluginLibraries& libraries, std::string endpoint, LinkKeys keys,
                 Watched watched, OnEvent on_event)
    : pool_(pool),
      clock_(clock),
      watched_(watched),
      on_event_(std::move(on_event)),
      events_(on_event_),
      libraries_(libraries),
      taps_(on_event_),
      links_(pool, clock, std::move(endpoint), std::move(keys), [this](std::uint64_t wire, const std::string& reason) {
        wire::GroupMessage message;
        message.mutable_wire_lost()->set_wire(wire);
        message.mutable_wire_lost()->set_reason(reason);
        emit(std::move(message));
      }) {}

Runtime::~Runtime() {
  links_.stop();
  const std::string reason = "the process ends";
  for (auto& [id, wire] : wires_) wire.local->cut(reason);
  for (const auto& wire : retired_) wire->cut(reason);
  for (auto& [name, instance] : instances_) {
    // One whose handler still runs keeps its memory: the process ends soon.
    if (instance->hull->shut_down(instance->patience())) static_cast<void>(instance->hull.release());
  }
}

wire::GroupMessage Runtime::handle(const wire::GroupRequest& request) {
  let_failed_go();
  wire::GroupMessage reply;
  reply.mutable_done();
  try {
    dispatch(request, reply);
  } catch (...) {
    *reply.mutable_failure() = failure_of_exception();
  }
  reply.set_id(request.id());
  return reply;
}

void Runtime::dispatch(const wire::GroupRequest& request, wire::GroupMessage& reply) {
  using Request = wire::GroupRequest;
  switch (request.what_case()) {
    case Request::kCreate: return create(request.create());
    case Request::kDestroy: return destroy(request.destroy(), reply);
    case Request::kSetParameters: return set_parameters(request.set_parameters());
    case Request::kSetMode: return set_mode(request.set_mode());
    case Request::kWireLocal: return wire_local(request.wire_local(), *reply.mutable_switched());
    case Request::kWireProvide: return wire_provide(request.wire_provide());
    case Request::kSetPrescale: return set_prescale(request.set_prescale());
    case Request::kWireRequire: return wire_require(request.wire_require(), *reply.mutable_switched());
    case Request::kWireRelay: return wire_relay(request.wire_relay());
    case Request::kAwait: return await(request.await());
    case Request::kArrange: return arrange(request.arrange(), *reply.mutable_switched());
    case Request::kCut: return cut(request.cut());
    case Request::kStatus: return status(*reply.mutable_status());
    case Request::kTap: return taps_.tap(request.tap(), *find(request.tap().watch().port().instance()).hull);
    case Request::kUntap: return taps_.untap(request.untap().tap());
    case Request::kRead: {
      const auto& probe = request.read().probe();
      *reply.mutable_tapped() = read_probe(*find(probe.instance()).hull, probe.port());
      return;
    }
    case Request::kCall: return call(request.call());
    case Request::kGiveUpCall: return give_up_call(request.give_up_call());
    case Request::kPeerLost: {
      const auto& gone = request.peer_lost();
      return links_.peer_lost(gone.endpoint(), gone.name(), gone.reason());
    }
    case Request::kAnswered: return answered(request.answered());
    case Request::kAdopt:
    case Request::kInventory: return tell_held(*reply.mutable_adopted());
    case Request::kPing: return;
    case Request::kWelcome:
      throw Error(ErrorCode::Usage, {.what = "the group has its key already", .next = "a group is welcomed once"});
    case Request::WHAT_NOT_SET:
      throw Error(ErrorCode::Usage, {.what = "the request is empty, or newer than this program",
                                     .next = "start all processes of a system from one installation of FIONA"});
  }
}

Runtime::Instance& Runtime::find(const std::string& name) {
  const auto found = instances_.find(name);
  if (found != instances_.end()) return *found->second;
  throw Error(ErrorCode::NotFound, {.what = "there is no instance '" + name + "' in this process",
                                    .next = "ls tells which group each instance is in"});
}

}  // namespace fiona::host
