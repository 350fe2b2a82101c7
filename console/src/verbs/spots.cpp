#include "../white_spots.hpp"

#include <fmt/format.h>

#include "../system_view.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

void print(Session& session, const std::vector<WhiteSpot>& spots, bool required, const char* heading) {
  Table table({"port", "service", "state", "who could", "type"});
  for (const WhiteSpot& spot : spots) {
    if (spot.required != required) continue;
    const std::string state = spot.required ? (spot.optional ? spot.reason + ", optional" : spot.reason) : "unused";
    if (spot.fillers.empty()) table.add({spot.port, short_name(spot.service), state, "nobody known", ""});
    for (const Filler& filler : spot.fillers)
      table.add(
          {spot.port, short_name(spot.service), state, fmt::format("{}: {}", filler.from, filler.what), filler.line});
  }
  if (table.empty()) return;
  session.out.text(heading);
  session.out.table(table, "");
}

}  // namespace

void spots(Session& session, const Line&) {
  const control::System system = session.snapshot();
  const Catalogue catalogue = session.catalogue();
  const std::vector<WhiteSpot> found = white_spots(system, catalogue);
  if (found.empty())
    session.out.text(system.instances().empty() ? "nothing is loaded, so there are no white spots" : "no white spots");
  print(session, found, true, "required, nobody serves it");
  print(session, found, false, "provided, nobody uses it");
}

}  // namespace fiona::console::verbs
