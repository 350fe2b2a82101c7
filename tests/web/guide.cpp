// A walker who goes where the page says, along the walking graph, without error: what a page is tested with.
#include <algorithm>
#include <cmath>
#include <limits>
#include <queue>
#include <string>
#include <vector>

#include "fiona/component.hpp"
#include "fiona/hmi.fiona.hpp"
#include "fiona/localisation.fiona.hpp"
#include "fiona/navigation.fiona.hpp"
#include "fiona/plugin.hpp"

namespace {

using namespace fiona;
using localisation::CommPosition;

constexpr double kSpeed_m_s = 1.6;
constexpr double kPeriod_s = 0.2;
constexpr double kLevelTime_s = 4;

class Guide final : public Component {
 public:
  using Component::Component;

 private:
  Async<> on_destination(const navigation::CommDestination& destination) {
    const CommPosition to = destination.destination();
    auto map = co_await levels_.query({}, std::chrono::seconds(2));
    if (!map) co_return;
    way_ = way((**map), here_, to);
    walked_ = 0;
    tell_path();
  }

  /// The cheapest way through the graph (Dijkstra 1959).
  static std::vector<CommPosition> way(const navigation::CommLevelMap& map, const CommPosition& from,
                                       const CommPosition& to) {
    std::vector<std::vector<std::pair<int, double>>> next(static_cast<std::size_t>(map.nodes_size()));
    for (const navigation::MapEdge& edge : map.edges()) {
      next[edge.from()].emplace_back(static_cast<int>(edge.to()), edge.cost());
      if (!edge.one_way()) next[edge.to()].emplace_back(static_cast<int>(edge.from()), edge.cost());
    }
    const auto nearest = [&](const CommPosition& place) {
      int best = 0;
      const auto away = [&](int i) {
        const auto& node = map.nodes(i);
        return std::hypot(node.x() - place.x(), node.y() - place.y()) + 1000 * std::abs(node.level() - place.z());
      };
      for (int i = 1; i < map.nodes_size(); ++i) {
        if (away(i) < away(best)) best = i;
      }
      return best;
    };
    std::vector<double> cost(next.size(), std::numeric_limits<double>::infinity());
    std::vector<int> before(next.size(), -1);
    const int goal = nearest(to);
    int at = nearest(from);
    cost[static_cast<std::size_t>(at)] = 0;
    std::priority_queue<std::pair<double, int>> open;
    open.emplace(0.0, at);
    while (!open.empty()) {
      const auto [minus, node] = open.top();
      open.pop();
      if (-minus > cost[static_cast<std::size_t>(node)]) continue;
      for (const auto& [other, edge] : next[static_cast<std::size_t>(node)]) {
        const double sum = edge - minus;
        if (sum >= cost[static_cast<std::size_t>(other)]) continue;
        cost[static_cast<std::size_t>(other)] = sum;
        before[static_cast<std::size_t>(other)] = node;
        open.emplace(-sum, other);
      }
    }
    std::vector<CommPosition> found{to};
    for (at = goal; at >= 0; at = before[static_cast<std::size_t>(at)]) {
      CommPosition place;
      place.set_x(map.nodes(at).x());
      place.set_y(map.nodes(at).y());
      place.set_z(map.nodes(at).level());
      found.push_back(place);
    }
    found.push_back(from);
    std::reverse(found.begin(), found.end());
    for (CommPosition& place : found) place.set_is_valid(true);
    return found;
  }

  static double length(const CommPosition& a, const CommPosition& b) {
    return std::hypot(b.x() - a.x(), b.y() - a.y()) + kLevelTime_s * kSpeed_m_s * std::abs(b.z() - a.z());
  }

  void walk() {
    if (!here_.is_valid()) {
      here_.set_x(start_x);
      here_.set_y(start_y);
      here_.set_z(0);
      here_.set_is_valid(true);
    }
    walked_ += kSpeed_m_s * kPeriod_s;
    double left = walked_;
    for (std::size_t i = 1; i < way_.size(); ++i) {
      const double piece = length(way_[i - 1], way_[i]);
      const double share = piece > 0 ? std::min(1.0, left / piece) : 1.0;
      here_.set_x(way_[i - 1].x() + share * (way_[i].x() - way_[i - 1].x()));
      here_.set_y(way_[i - 1].y() + share * (way_[i].y() - way_[i - 1].y()));
      here_.set_z(share < 0.5 ? way_[i - 1].z() : way_[i].z());
      left -= piece;
      if (left <= 0) break;
    }
    localisation::CommLocation location;
    *location.mutable_position() = here_;
    location.set_is_valid(true);
    // Longer across the way than along it, and turned, so that the ellipse is one.
    for (const double value : {0.5, 0.2, 0.0, 0.2, 0.3, 0.0, 0.0, 0.0, 0.01})
      location.mutable_position()->add_confidence(value);
    location_.put(std::move(location));
    instruct();
    path_.still_valid();
  }

  void instruct() {
    hmi::Instruction instruction;
    double total = 0;
    for (std::size_t i = 1; i < way_.size(); ++i) total += length(way_[i - 1], way_[i]);
    const double left = total - walked_;
    const bool there = !way_.empty() && left <= 0;
    instruction.set_number(there ? 2 : 1);
    instruction.set_language("en");
    instruction.set_kind(way_.empty() ? hmi::Instruction::START
                         : there      ? hmi::Instruction::ARRIVE
                                      : hmi::Instruction::CONTINUE);
    instruction.set_text(way_.empty() ? "Choose a destination" : there ? "You have arrived" : "Follow the path");
    if (!way_.empty() && !there) instruction.set_distance(left);
    if (!way_.empty() && !there) instruction.set_hour(hmi::NextTurn::HOUR_12);
    instructions_.put(std::move(instruction));
  }

  void tell_path() {
    navigation::CommPath path;
    for (const CommPosition& place : way_) *path.add_waypoints() = place;
    path.set_is_valid(true);
    path_.put(std::move(path));
  }

  static constexpr double start_x = 4;
  static constexpr double start_y = 4;

  Requires<navigation::LevelMap> levels_{*this, "levels"};
  Provides<navigation::DestinationProvider> destination_{*this, "destination", &Guide::on_destination};
  Provides<navigation::PathProvider> path_{*this, "path"};
  Provides<hmi::InstructionProvider> instructions_{*this, "instructions"};
  Provides<localisation::LocationProvider> location_{*this, "location", &Guide::walk};
  std::vector<CommPosition> way_;
  CommPosition here_;
  double walked_ = 0;
};

}  // namespace

FIONA_PLUGIN(plugin) { plugin.add<Guide>("guide", "goes where the page says"); }
