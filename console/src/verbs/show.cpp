#include <algorithm>
#include <chrono>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <fiona/service.hpp>

#include "../catalogue.hpp"
#include "../locations.hpp"
#include "../system_view.hpp"
#include "verbs.hpp"

#include "fiona/options.pb.h"

namespace fiona::console::verbs {
namespace {

namespace pb = google::protobuf;

void show_ports(Session& session, const control::InstanceStatus& instance) {
  Table table({"port", "direction", "service", "pattern", "connection", "peer", "messages", "rate", "age", "doc"});
  for (const auto& port : instance.ports()) {
    const bool required = port.direction() == fiona::REQUIRES;
    table.add({port.name(),
               required ? (port.optional() ? "requires, optional" : "requires") : "provides",
               short_name(port.service()),
               pattern_text(port.pattern()),
               required ? connection_text(port) : "",
               required ? (port.peer().instance().empty() ? "" : text_of(port.peer())) : clients_text(port),
               {fmt::format("{}", port.messages()), port.messages()},
               {rate_text(port.rate_hz()), port.rate_hz()},
               {age_text(port.age_ms()), port.age_ms()},
               port.doc()});
  }
  session.out.table(table, "it has no ports");
}

/// Those that the component declares, with the values of now; with -v also those that every hull has.
void show_probes(Session& session, const control::InstanceStatus& instance) {
  Table table({"probe", "value", "unit", "age", "doc"});
  for (const auto& probe : instance.probes())
    table.add({probe.name(), probe.value(), probe.unit(), {age_text(probe.age_ms()), probe.age_ms()}, probe.doc()});
  const auto all = probes_of(instance);
  for (std::size_t i = static_cast<std::size_t>(instance.probes_size()); session.out.manner.verbose && i < all.size();
       ++i)
    table.add({all[i].name, "", all[i].unit, "", all[i].doc});
  if (!table.empty()) session.out.text("");
  session.out.table(table, "");
}

/// One probe, read for it.
void show_probe(Session& session, const control::InstanceStatus& instance, const ProbeInfo& probe) {
  control::Request request;
  request.mutable_read()->mutable_probe()->set_instance(instance.name());
  request.mutable_read()->mutable_probe()->set_port(probe.name);
  const control::Sample sample = session.call(std::move(request)).sample();
  Table facts({"fact", "value"});
  facts.add({"probe", instance.name() + "." + probe.name});
  facts.add({"type", probe.type});
  if (!probe.unit.empty()) facts.add({"unit", probe.unit});
  if (!probe.doc.empty()) facts.add({"doc", probe.doc});
  const TypeSet types(sample.files());
  const auto object = types.make(sample.type());
  if (!object) {
    facts.add({"value", "none yet"});
    return session.out.table(facts, "", false);
  }
  if (!object->ParseFromString(sample.object()))
    throw Error(ErrorCode::Failed, {.what = fmt::format("a {} cannot be read", sample.type()),
                                    .where = instance.name(),
                                    .next = "tell the component's publisher: market info tells who"});
  for (const FieldText& field : field_texts(*object, {})) {
    const std::string& unit = is_plain_value(sample.type()) ? sample.unit() : field.unit;
    facts.add({field.path, field.text + (unit.empty() ? "" : " " + unit)});
  }
  facts.add({"age", {age_text(sample.age_ms()), sample.age_ms()}});
  session.out.table(facts, "", false);
}

std::string mode_text(const control::InstanceStatus& instance) {
  if (!instance.has_pending()) return instance.mode();
  const auto& pending = instance.pending();
  return fmt::format("{}, to {}: blocked by {} for {:.1f} s", instance.mode(), pending.to(), pending.blocked_by(),
                     pending.blocked_s());
}

/// "every 100 ms", "on scans, every 4": what starts a task.
std::string when_text(const fiona::TaskInterface& task) {
  switch (task.start()) {
    case fiona::ON_PORT:
      return task.every() > 1 ? fmt::format("on {}, every {}", task.of(), task.every()) : "on " + task.of();
    case fiona::AFTER_TASK: return "after " + task.of();
    case fiona::FREE_RUNNING: return "free running";
    default: return fmt::format("every {:g} ms", task.period_ms());
  }
}

std::string sandbox_text(const control::GroupStatus& group) {
  if (group.sandbox().empty()) return "none: it has the rights of the host's user";
  std::vector<std::string> layers;
  for (const auto& layer : group.sandbox()) {
    layers.push_back(layer.missing().empty() ? fmt::format("{} ({})", layer.name(), layer.detail())
                                             : fmt::format("no {}: {}", layer.name(), layer.missing()));
  }
  return fmt::format("{}", fmt::join(layers, ", "));
}

/// What has gone to and come from other processes, if anything has.
void add_links(Table& facts, const control::LinkStatus& links) {
  constexpr double kMiB = 1U << 20U;
  if (links.sent_messages() + links.received_messages() == 0) return;
  facts.add(
      {"links",
       {fmt::format("{:.1f} MiB sent, {:.1f} of it through memory; {:.1f} MiB received",
                    static_cast<double>(links.sent_bytes()) / kMiB, static_cast<double>(links.memory_bytes()) / kMiB,
                    static_cast<double>(links.received_bytes()) / kMiB),
        links.sent_bytes()}});
  const auto refused = links.garbled() + links.unproven() + links.not_granted() + links.too_large() + links.overrun();
  if (refused > 0) facts.add({"refused at links", {fmt::format("{} messages", refused), refused}});
  if (links.late() > 0) {
    facts.add({"late at links", {fmt::format("{} frames, behind the end of their wires", links.late()), links.late()}});
  }
}

/// Of `main`, which is the host, there is nothing to add.
void add_group(Table& facts, const control::System& system, const std::string& name) {
  const auto found = std::find_if(system.groups().begin(), system.groups().end(),
                                  [&](const control::GroupStatus& group) { return group.name() == name; });
  if (found == system.groups().end() || found->memory_limit() == 0) return;
  facts.add({"sandbox", sandbox_text(*found)});
  facts.add(
      {"memory", {fmt::format("{} MiB of {}", found->memory() >> 20U, found->memory_limit() >> 20U), found->memory()}});
  facts.add({"threads", {fmt::format("{} of {}", found->threads(), found->threads_limit()), found->threads()}});
  if (found->descriptors() > 0) {
    facts.add({"descriptors",
               {fmt::format("{} of {}", found->descriptors(), found->descriptors_limit()), found->descriptors()}});
  }
  const std::string most = found->cpu_limit() > 0 ? fmt::format(" of {:.2f}", found->cpu_limit()) : "";
  const std::string held = found->cpu_held_by().empty() ? "" : "; more once, so " + found->cpu_held_by();
  facts.add({"cpu", {fmt::format("{:.2f}{} cores{}", found->cpu(), most, held), found->cpu()}});
  add_links(facts, found->links());
  if (found->dropped_output() > 0) {
    facts.add({"dropped output", {fmt::format("{} bytes", found->dropped_output()), found->dropped_output()}});
  }
}

void show_instance(Session& session, const control::System& system, const control::InstanceStatus& instance) {
  Table facts({"fact", "value"});
  facts.add({"instance", instance.name()});
  facts.add({"plugin", fmt::format("{} {}", instance.plugin(), instance.version())});
  facts.add({"component", instance.component()});
  facts.add({"mode", mode_text(instance)});
  if (!instance.reason().empty()) facts.add({"reason", instance.reason()});
  facts.add({"modes", fmt::format("{}", fmt::join(instance.modes(), ", "))});
  facts.add({"group", instance.group()});
  add_group(facts, system, instance.group());
  if (instance.restarts() > 0) {
    const std::string of = instance.group() == "main"
                               ? "the host: " + system.restart_reason()
                               : fmt::format("its group's process, {} ago: {}", age_text(1000 * instance.restarted_s()),
                                             instance.restart_reason());
    facts.add({"restarts", {fmt::format("{} of {}", instance.restarts(), of), instance.restarts()}});
  }
  if (!instance.stands_by().empty())
    facts.add({"stands by", instance.stands_by() + ", which serves again if this one fails"});
  if (!instance.rights().empty()) facts.add({"rights", fmt::format("{}", fmt::join(instance.rights(), ", "))});
  facts.add({"handlers",
             {fmt::format("{:.1f} ms busy, {:.1f} ms of it on a CPU", instance.handler_ms(), instance.cpu_ms()),
              instance.handler_ms()}});
  facts.add({"queue", {fmt::format("{}", instance.queue_depth()), instance.queue_depth()}});
  if (!instance.doc().empty()) facts.add({"doc", instance.doc()});
  session.out.table(facts, "", false);
  session.out.text("");
  show_ports(session, instance);
  Table parameters({"parameter", "value", "unit", "range", "default", "doc"});
  for (const auto& parameter : instance.parameters())
    parameters.add({parameter.name(), parameter.value(), parameter.unit(), parameter.range(), parameter.default_value(),
                    parameter.doc()});
  if (!parameters.empty()) session.out.text("");
  session.out.table(parameters, "");
  Table tasks({"task", "activity", "when", "runs", "overruns"});
  for (const auto& task : instance.tasks())
    tasks.add({task.task().name(),
               task.task().activity(),
               when_text(task.task()),
               {fmt::format("{}", task.runs()), task.runs()},
               {fmt::format("{}", task.overruns()), task.overruns()}});
  if (!tasks.empty()) session.out.text("");
  session.out.table(tasks, "");
  show_probes(session, instance);
  Table triggers({"trigger", "activity", "argument", "result", "doc"});
  for (const auto& trigger : instance.triggers())
    triggers.add({trigger.name(), trigger.activity(), short_name(trigger.argument()), short_name(trigger.result()),
                  trigger.doc()});
  if (!triggers.empty()) session.out.text("");
  session.out.table(triggers, "");
}

/// How far back the journal is searched for who made a wire.
constexpr std::uint32_t kEntriesSearched = 200;

/// Who wired the port as it is wired, and when; empty where the journal does not say so (any more).
std::string wired_by_text(Session& session, const std::string& client) {
  control::Request request;
  request.mutable_journal()->set_last(kEntriesSearched);
  const control::Reply reply = session.call(std::move(request));
  const auto& entries = reply.journal().entries();
  const auto wires = [&client](const control::Change& step) {
    return step.has_wire() && text_of(step.wire().client()) == client;
  };
  for (auto entry = entries.rbegin(); entry != entries.rend(); ++entry) {
    if (entry->state() != control::JournalEntry::DONE) continue;
    if (std::none_of(entry->steps().begin(), entry->steps().end(), wires)) continue;
    const auto now = std::chrono::system_clock::now().time_since_epoch();
    const double ago_ms =
        std::chrono::duration<double, std::milli>(now).count() - static_cast<double>(entry->time_ms());
    return fmt::format("{}, {} ago (journal {})", entry->author(), age_text(std::max(0.0, ago_ms)), entry->number());
  }
  return "";
}

void show_port(Session& session, const control::InstanceStatus& instance, const control::PortStatus& port) {
  const bool required = port.direction() == fiona::REQUIRES;
  Table facts({"fact", "value"});
  facts.add({"port", instance.name() + "." + port.name()});
  facts.add({"direction", required ? (port.optional() ? "requires, optional" : "requires") : "provides"});
  facts.add({"service", port.service()});
  facts.add({"pattern", pattern_text(port.pattern())});
  if (!port.activity().empty()) facts.add({"activity", port.activity()});
  if (required) facts.add({"connection", fmt::format("{}, for {:.1f} s", connection_text(port), port.since_s())});
  if (required && !port.peer().instance().empty()) facts.add({"wired to", text_of(port.peer())});
  const std::string wired_by = required ? wired_by_text(session, instance.name() + "." + port.name()) : "";
  if (!wired_by.empty()) facts.add({"wired by", wired_by});
  if (required && port.prescale() > 1) facts.add({"every", {fmt::format("{}", port.prescale()), port.prescale()}});
  if (required && !port.transport().empty()) facts.add({"transport", port.transport()});
  for (const auto& one : port.providers())
    facts.add({"provider", fmt::format("{}{}{}", alternative_text(one), one.transport().empty() ? "" : ", over ",
                                       one.transport())});
  if (!port.providers().empty()) {
    facts.add({"hold", {fmt::format("{:g} s", port.hold_ms() / 1000), port.hold_ms()}});
    facts.add({"flaps", {fmt::format("{}", port.flaps()), port.flaps()}});
  }
  if (!required) facts.add({"clients", clients_text(port)});
  for (const auto& [name, count] : {std::pair{"messages", port.messages()},
                                    {"superseded", port.superseded()},
                                    {"dropped", port.dropped()},
                                    {"refused", port.refused()}})
    facts.add({name, {fmt::format("{}", count), count}});
  if (!port.refusal().empty())
    facts.add({"refusal", fmt::format("{}, {} ago", port.refusal(), age_text(port.refusal_age_ms()))});
  facts.add({"rate", {rate_text(port.rate_hz()), port.rate_hz()}});
  facts.add({"age", {age_text(port.age_ms()), port.age_ms()}});
  if (port.latency_p50_ms() > 0) {
    facts.add({"p50", {latency_text(port.latency_p50_ms()) + " of latency", port.latency_p50_ms()}});
    facts.add({"p99", {latency_text(port.latency_p99_ms()) + " of latency", port.latency_p99_ms()}});
  }
  if (!port.doc().empty()) facts.add({"doc", port.doc()});
  session.out.table(facts, "", false);
  session.out.text(fmt::format("\nmore: show {}", short_name(port.service())));
}

void show_object(Session& session, const pb::Descriptor& type) {
  session.out.text(fmt::format("{}", type.full_name()));
  session.out.table(field_table(type), "it has no fields");
}

void show_service(Session& session, const pb::ServiceDescriptor& service) {
  const auto& contract = service.options().GetExtension(fiona::contract);
  Table facts({"fact", "value"});
  facts.add({"service", service.full_name()});
  facts.add({"pattern", pattern_text(contract.pattern())});
  facts.add({"version", fmt::format("{}.{}", std::max(1U, contract.major()), contract.minor())});
  if (contract.period_ms() > 0)
    facts.add({"period", {fmt::format("{} ms", contract.period_ms()), contract.period_ms()}});
  const fiona::ServiceInfo info(service);
  const auto lease_ms = std::chrono::duration_cast<std::chrono::milliseconds>(info.lease()).count();
  if (info.is_push()) {
    facts.add({"lease", {lease_ms > 0 ? fmt::format("{} ms", lease_ms) : "none: it may be silent", lease_ms}});
    facts.add({"last value", contract.last_value() ? "given to who comes later" : "not kept"});
  }
  if (contract.pattern() == fiona::QUERY)
    facts.add({"idempotent", contract.idempotent() ? "yes: it may be asked again" : "no"});
  const std::string doc = service.options().GetExtension(fiona::service_doc);
  if (!doc.empty()) facts.add({"doc", doc});
  session.out.table(facts, "", false);
  for (int i = 0; i < service.method_count(); ++i) {
    for (const auto* type : {service.method(i)->input_type(), service.method(i)->output_type()}) {
      if (type->full_name() == "fiona.None") continue;
      session.out.text("");
      show_object(session, *type);
    }
  }
}

void show_plugin(Session& session, const KnownPlugin& plugin) {
  Table facts({"fact", "value"});
  facts.add({"plugin", plugin.name()});
  facts.add({"version", plugin.manifest.version()});
  facts.add({"summary", plugin.manifest.summary()});
  facts.add({"license", plugin.manifest.license()});
  facts.add({"where", plugin.installed ? "installed" : "marketplace: market install " + plugin.name()});
  if (!plugin.mark.empty()) facts.add({"state", plugin.mark});
  for (const std::string& shown : split_lines(plugin.manifest.try_())) facts.add({"try", shown});
  session.out.table(facts, "", false);
  for (const auto& component : plugin.interface.components()) {
    session.out.text(fmt::format("\n{}  {}", component.name(), component.doc()));
    Table ports({"port", "direction", "service", "doc"});
    for (const auto& port : component.ports())
      ports.add({port.name(),
                 port.direction() == fiona::PROVIDES ? "provides"
                 : port.optional()                   ? "requires, optional"
                                                     : "requires",
                 port.service(), port.doc()});
    session.out.table(ports, "it has no ports");
    Table probes({"probe", "type", "unit", "doc"});
    for (const auto& probe : component.probes()) probes.add({probe.name(), probe.type(), probe.unit(), probe.doc()});
    if (!probes.empty()) session.out.text("");
    session.out.table(probes, "");
  }
}

void show_parameters(Session& session, const Catalogue& catalogue, const KnownPlugin& plugin) {
  for (const auto& component : plugin.interface.components()) {
    const auto* type = component.parameters().empty() || !plugin.installed
                           ? nullptr
                           : catalogue.types_of(plugin).object(component.parameters());
    if (type == nullptr) continue;
    session.out.text(fmt::format("\nparameters of {}", component.name()));
    session.out.table(field_table(*type), "");
  }
}

/// A type of the platform whose full name or last part is `name`.
template <class Find>
auto platform_type(const std::string& name, Find find) -> decltype(find(name)) {
  if (const auto* exact = find(name)) return exact;
  for (const char* package : {"fiona", "fiona.sensors", "fiona.perception", "fiona.localisation", "fiona.navigation",
                              "fiona.security", "fiona.hmi"}) {
    if (const auto* found = find(std::string(package) + "." + name)) return found;
  }
  return nullptr;
}

bool show_described(Session& session, const std::string& name) {
  control::Request request;
  request.mutable_describe()->set_name(name);
  try {
    const control::Reply reply = session.call(std::move(request));
    const TypeSet types(reply.description().files());
    if (const auto* service = reply.description().is_service() ? types.service(reply.description().name()) : nullptr)
      return show_service(session, *service), true;
    if (const auto* type = types.object(reply.description().name())) return show_object(session, *type), true;
  } catch (const Error& problem) {
    if (problem.code() != ErrorCode::NotFound) throw;
  }
  return false;
}

bool show_platform(Session& session, const std::string& name) {
  const auto* pool = pb::DescriptorPool::generated_pool();
  const auto* service = platform_type(name, [pool](const std::string& full) { return pool->FindServiceByName(full); });
  if (service != nullptr) return show_service(session, *service), true;
  const auto* type = platform_type(name, [pool](const std::string& full) { return pool->FindMessageTypeByName(full); });
  if (type != nullptr) return show_object(session, *type), true;
  return false;
}

}  // namespace

void show(Session& session, const Line& line) {
  const Word& thing = line.positional[0];
  std::vector<std::string> known;
  const bool running = session.host_if_running() != nullptr;
  if (running) {
    const control::System system = session.snapshot();
    const std::string first = thing.text.substr(0, thing.text.find('.'));
    if (const auto* instance = find_instance(system, first)) {
      if (first == thing.text) return show_instance(session, system, *instance);
      const std::string part = thing.text.substr(first.size() + 1);
      const auto probes = probes_of(*instance);
      const auto probe =
          std::find_if(probes.begin(), probes.end(), [&part](const auto& one) { return one.name == part; });
      if (probe != probes.end()) return show_probe(session, *instance, *probe);
      return show_port(session, *instance, port_at(system, thing, line));
    }
    known = instance_names(system);
  }
  const Catalogue catalogue = session.catalogue();
  if (const auto found = catalogue.find(thing.text); !found.empty()) {
    show_plugin(session, *found.front().plugin);
    return show_parameters(session, catalogue, *found.front().plugin);
  }
  if (running && show_described(session, thing.text)) return;
  if (show_platform(session, thing.text)) return;
  for (const std::string& name : catalogue.names()) known.push_back(name);
  throw line.error(thing,
                   {.what = fmt::format("there is no instance, port, plugin, service or object '{}'", thing.text),
                    .next = running ? "ls" : "ls plugins",
                    .near = nearest_names(thing.text, known)},
                   ErrorCode::NotFound);
}

}  // namespace fiona::console::verbs
