#include <fmt/format.h>

#include "../diagnosis.hpp"
#include "../system_view.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

/// "5 Hz, newest 40 ms old": how well it is.
std::string pulse_text(const control::PortStatus& port) {
  if (port.age_ms() < 0) return "nothing yet";
  return fmt::format("{}, newest {} old", rate_text(port.rate_hz()), age_text(port.age_ms()));
}

}  // namespace

void why(Session& session, const Line& line) {
  const Word& thing = line.positional[0];
  const control::System system = session.snapshot();
  const auto& instance = instance_at(system, thing, line);
  const bool is_instance = thing.text.find('.') == std::string::npos;
  const control::PortStatus* port = is_instance ? nullptr : &port_at(system, thing, line);
  const auto found = port == nullptr ? findings_of(system, instance) : findings_of(system, instance, *port);
  if (found.empty()) {
    const std::string how = port == nullptr ? instance.mode() : pulse_text(*port);
    session.out.object({{"thing", thing.text}, {"state", how}});
    return session.out.text(fmt::format("nothing is wrong with {}, or with what it needs: {}", thing.text, how));
  }
  Table table({"thing", "state", "for", "next"});
  for (const Finding& one : found) {
    const bool known = one.since_s >= 0;
    table.add(
        {one.thing,
         one.state,
         {known ? age_text(1000 * one.since_s) : "", known ? nlohmann::json(one.since_s) : nlohmann::json(nullptr)},
         one.next});
  }
  session.out.table(table, "");
}

}  // namespace fiona::console::verbs
