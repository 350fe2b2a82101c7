// set, get, state: what changes or shows one instance.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include "../changes.hpp"
#include "../system_view.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {

void set(Session& session, const Line& line) {
  control::Change change;
  change.mutable_set()->set_instance(line.positional[0].text);
  for (control::Argument& argument : line.control_arguments())
    *change.mutable_set()->add_parameters() = std::move(argument);
  make(session, line, std::move(change), fmt::format("set {}", line.positional[0].text));
}

namespace {

void get_host(Session& session, const control::System& system, const Line& line) {
  const std::string wanted = line.positional.size() > 1 ? line.positional[1].text : "";
  Table table({"parameter", "value", "unit", "range", "default", "doc"});
  if (wanted.empty() || wanted == "clock")
    table.add({"clock", system.clock(), "", "system|virtual", "system", "what time the instances see"});
  if (wanted.empty() || wanted == "start")
    table.add({"start", system.clock_start().empty() ? "0" : system.clock_start(), "", "1970 .. 2039", "0",
               "of a virtual clock: its first moment, for a recording that is played at its own times"});
  if (wanted.empty() || wanted == "speed")
    table.add({"speed",
               {fmt::format("{}", system.speed()), system.speed()},
               "",
               "from 0",
               "1",
               "of a virtual clock, times real time; 0: as fast as it goes"});
  if (wanted.empty() || wanted == "deliveries")
    table.add({"deliveries", system.deliveries(), "", "", "",
               "of a virtual clock: the file in which each delivery is recorded"});
  if (table.empty()) {
    const std::vector<std::string> known{"clock", "start", "speed", "deliveries"};
    throw line.error(line.positional[1],
                     {.what = fmt::format("the host has no parameter '{}'", wanted),
                      .expected = fmt::format("{}", fmt::join(known, ", ")),
                      .near = nearest_names(wanted, known)},
                     ErrorCode::NotFound);
  }
  session.out.table(table, "");
}

}  // namespace

void get(Session& session, const Line& line) {
  const control::System system = session.snapshot();
  const std::string wanted = line.positional.size() > 1 ? line.positional[1].text : "";
  if (line.positional[0].text == "host") return get_host(session, system, line);
  const auto& instance = instance_at(system, line.positional[0], line);
  Table table({"parameter", "value", "unit", "range", "default", "doc"});
  std::vector<std::string> known;
  for (const auto& parameter : instance.parameters()) {
    known.push_back(parameter.name());
    const bool shown = wanted.empty() || parameter.name() == wanted || parameter.name().starts_with(wanted + ".");
    if (shown)
      table.add({parameter.name(), parameter.value(), parameter.unit(), parameter.range(), parameter.default_value(),
                 parameter.doc()});
  }
  if (table.empty() && !wanted.empty()) {
    throw line.error(line.positional[1],
                     {.what = fmt::format("{} has no parameter '{}'", instance.name(), wanted),
                      .next = fmt::format("get {}", instance.name()),
                      .near = nearest_names(wanted, known)},
                     ErrorCode::NotFound);
  }
  session.out.table(table, fmt::format("{} has no parameters", instance.name()));
}

void state(Session& session, const Line& line) {
  if (line.positional.size() == 1) {
    const control::System system = session.snapshot();
    const auto& instance = instance_at(system, line.positional[0], line);
    const std::vector<std::string> modes(instance.modes().begin(), instance.modes().end());
    session.out.object(
        {{"instance", instance.name()}, {"mode", instance.mode()}, {"modes", modes}, {"reason", instance.reason()}});
    std::string text = fmt::format("{} is {}", instance.name(), instance.mode());
    if (!instance.reason().empty()) text += ": " + instance.reason();
    if (!modes.empty()) text += fmt::format("  (it knows neutral, deactivated, {})", fmt::join(modes, ", "));
    return session.out.text(text);
  }
  control::Change change;
  change.mutable_state()->set_instance(line.positional[0].text);
  change.mutable_state()->set_mode(line.positional[1].text);
  if (const Word* within = line.clause("for")) change.mutable_state()->set_within_ms(duration_ms(*within, line.words));
  make(session, line, std::move(change), fmt::format("{} is {}", line.positional[0].text, line.positional[1].text));
}

}  // namespace fiona::console::verbs
