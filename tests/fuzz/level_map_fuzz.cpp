// Level maps of other suppliers, as text: what the rules of the contract let pass is refused in a sentence, or is a
// plan that one can see, ask and walk by, for navigation and for localisation.
#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "fiona/error.hpp"
#include "fiona/rules.hpp"
#include "floor_plan.hpp"
#include "level_plan.hpp"

namespace {

using fiona::navigation::CommLevelMap;

struct Silent final : google::protobuf::io::ErrorCollector {
  void AddError(int, google::protobuf::io::ColumnNumber, const std::string&) override {}
};

void navigate(const CommLevelMap& map) {
  const auto plan = fiona::guidance::read_level_plan(map);
  plan.level_near(0.0, 1.0);
  plan.walled({0.0, 0.0}, {10.0, 10.0}, 0.0);
  plan.behind_door({0.0, 0.0}, {10.0, 10.0}, 0.0);
  plan.room_name({{1.0, 1.0}, 0.0});
  if (plan.graph.nodes.size() != static_cast<std::size_t>(map.nodes_size())) std::abort();
  if (plan.graph.nodes.empty()) return;
  const auto& from = plan.graph.nodes.front();
  const auto& to = plan.graph.nodes.back();
  fiona::building::find_route(plan.plan, plan.graph, {from.at, from.level}, {to.at, to.level}, {});
}

void locate(const CommLevelMap& map) {
  const fiona::beacons::FloorPlan plan(map);
  for (const auto& extent : plan.extents()) {
    plan.wall_between(extent.level, extent.low_x_m, extent.low_y_m, extent.low_x_m + 1.0, extent.low_y_m + 1.0);
    const double x_m = (extent.low_x_m + extent.high_x_m) / 2, y_m = (extent.low_y_m + extent.high_y_m) / 2;
    plan.may_be_at(extent.level, x_m, y_m);
    plan.is_closed(extent.level, x_m, y_m);
  }
  for (const auto& way : plan.ways()) {
    if (way.from_level == way.to_level || !std::isfinite(way.at(0.5).x_m)) std::abort();
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const fiona::ObjectRules kRules(*CommLevelMap::descriptor());
  google::protobuf::TextFormat::Parser parser;
  Silent silent;
  parser.RecordErrorsTo(&silent);
  parser.SetRecursionLimit(10);
  CommLevelMap map;
  if (!parser.ParseFromString(std::string(reinterpret_cast<const char*>(data), size), &map)) return 0;
  if (kRules.first_violation(map)) return 0;
  for (auto* use : {&navigate, &locate}) {
    try {
      use(map);
    } catch (const fiona::Error& error) {
      if (error.text().what.empty()) std::abort();
    }
  }
  return 0;
}
