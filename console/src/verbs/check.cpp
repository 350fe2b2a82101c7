#include "../system_check.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "../system_view.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {

void check(Session& session, const Line& line) {
  const Catalogue catalogue = session.catalogue();
  for (const std::string& problem : catalogue.problems()) session.out.remark(problem);
  const CheckResult result = check_system(system_path(line.positional[0].text, session.options.store), catalogue);
  for (const std::string& remark : result.remarks) session.out.remark(remark);
  Table spots({"port", "service", "state", "who could"});
  for (const auto& spot : result.spots) {
    if (spot.optional && spot.could.empty()) continue;  // nothing is missing, and nothing at hand was forgotten
    spots.add({spot.port, short_name(spot.service), spot.optional ? "unwired, optional" : "unwired",
               fmt::format("{}", fmt::join(spot.could, ", "))});
  }
  if (!spots.empty()) session.out.text("required, nobody serves it");
  session.out.table(spots, "");
  // The last one is thrown, and told by whoever ran this line.
  for (std::size_t i = 0; i + 1 < result.errors.size(); ++i) session.out.error(result.errors[i]);
  if (!result.errors.empty()) throw LineError(result.errors.back());
  session.out.done(
      fmt::format("{}: {} lines, {} instances, no errors", line.positional[0].text, result.lines, result.instances),
      {{"lines", result.lines}, {"instances", result.instances}});
}

}  // namespace fiona::console::verbs
