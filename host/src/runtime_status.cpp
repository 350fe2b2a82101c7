// How the instances of one process are doing.
#include "fiona/describe.hpp"
#include "fiona/push.hpp"
#include "runtime.hpp"

namespace fiona::host {
namespace {

control::Connection to_proto(Connection connection) { return static_cast<control::Connection>(connection); }

void fill_required(control::PortStatus& status, RequiredPort& port, TimePoint now) {
  status.set_connection(to_proto(port.connection()));
  status.set_reason(port.connection_reason());
  status.set_since_s(to_seconds(now - port.connection_since()));
  status.set_flaps(port.flaps());
  for (const auto& one : port.alternatives()) {
    auto& provider = *status.add_providers();
    const std::size_t dot = one.provider.find('.');
    provider.mutable_provider()->set_instance(one.provider.substr(0, dot));
    provider.mutable_provider()->set_port(one.provider.substr(dot + 1));
    provider.set_connection(to_proto(one.connection));
    provider.set_reason(one.reason);
    provider.set_fit(one.fit);
    provider.set_serves(one.serves);
  }
}

void fill_push(control::PortStatus& status, Port& port) {
  if (!port.service().is_push()) return;
  const auto* provider = dynamic_cast<const detail::PushProvider*>(&port);
  status.set_lease_ms(1e3 * to_seconds(provider ? provider->lease() : port.service().lease()));
  status.set_silent(provider && provider->is_silent());
}

void fill_port(control::PortStatus& status, Port& port, TimePoint now) {
  PortCounters& counters = port.counters();
  status.set_name(port.name());
  status.set_direction(port.direction() == PortDirection::Provides ? PROVIDES : REQUIRES);
  status.set_service(port.service().name());
  status.set_pattern(port.service().pattern());
  status.set_optional(port.optional());
  status.set_doc(port.doc());
  status.set_activity(port.activity());
  status.set_messages(counters.messages);
  status.set_superseded(counters.superseded);
  status.set_dropped(counters.dropped);
  status.set_refused(counters.refused);
  if (const auto refusal = counters.last_refusal()) {
    status.set_refusal(refusal->reason);
    status.set_refusal_age_ms(1e3 * to_seconds(now - refusal->at));
  }
  const auto age = counters.age(now);
  status.set_age_ms(age ? 1e3 * to_seconds(*age) : -1);
  status.set_rate_hz(counters.rate_now_hz(now));
  status.set_not_active(counters.not_active);
  const auto latency = counters.latencies.recent(now);
  status.set_latency_p50_ms(latency ? 1e3 * to_seconds(latency->p50) : -1);
  status.set_latency_p99_ms(latency ? 1e3 * to_seconds(latency->p99) : -1);
  fill_push(status, port);
  if (auto* required = dynamic_cast<RequiredPort*>(&port)) fill_required(status, *required, now);
}

void fill_mode(control::InstanceStatus& status, const Hull& hull, TimePoint now) {
  status.set_mode(hull.mode());
  status.set_mode_since_s(to_seconds(now - hull.mode_since()));
  for (const auto& mode : hull.main_modes()) status.add_modes(mode);
  status.set_reason(hull.reason());
  const auto pending = hull.pending_change();
  if (!pending) return;
  status.mutable_pending()->set_to(pending->to);
  status.mutable_pending()->set_blocked_by(pending->blocked_by);
  status.mutable_pending()->set_blocked_s(to_seconds(now - pending->since));
}

}  // namespace

void Runtime::status(wire::GroupStatusReply& reply) {
  *reply.mutable_links() = links_.status();
  const TimePoint now = clock_.now();
  for (const auto& [name, instance] : instances_) *reply.add_instances() = status_of(*instance, now);
}

control::InstanceStatus Runtime::status_of(const Instance& instance, TimePoint now) {
  const Hull& hull = *instance.hull;
  control::InstanceStatus status;
  status.set_name(hull.name());
  status.set_plugin(instance.plugin);
  status.set_component(instance.component);
  status.set_version(instance.version);
  status.set_doc(instance.doc);
  fill_mode(status, hull, now);
  for (Port* port : hull.ports()) fill_port(*status.add_ports(), *port, now);
  if (hull.parameters()) {
    for (auto& one : hull.parameters()->status()) *status.add_parameters() = std::move(one);
    for (auto& one : hull.parameters()->differences()) *status.add_set_parameters() = std::move(one);
  }
  for (const auto* trigger : hull.triggers()) *status.add_triggers() = interface_of(*trigger);
  fill_probes(status, hull, now);
  for (const Task* task : hull.tasks()) {
    auto& one = *status.add_tasks();
    *one.mutable_task() = interface_of(*task);
    one.set_runs(task->runs());
    one.set_overruns(task->overruns());
  }
  status.set_handler_ms(1e3 * to_seconds(hull.strand().busy_time()));
  status.set_cpu_ms(1e3 * to_seconds(hull.strand().cpu_time()));
  status.set_queue_depth(hull.queue_depth());
  return status;
}

}  // namespace fiona::host
