#include "fiona/simulator/walker.hpp"

#include <algorithm>

#include <fiona/error.hpp>

namespace fiona::simulator {
namespace {

/// Chance may choose the room where one is; after so many times one waits for the next tick.
constexpr std::size_t kMostTries = 20;

}  // namespace

Walker::Walker(const building::Building& building, std::uint64_t seed, Options options)
    : building_(building),
      options_(std::move(options)),
      random_(seed, hash("walker")),
      goal_(first_room(building)),
      pedestrian_(building, {goal_->centre, goal_->level}, options_.gait),
      rooms_(reachable_rooms(building)) {
  if (rooms_.empty()) {
    throw Error(ErrorCode::Failed, {.what = "nobody can walk in " + building.name() + ": no way leads from " +
                                            (goal_->name.empty() ? text(goal_->id) : goal_->name) + " to another room",
                                    .where = building.name(),
                                    .expected = "rooms joined by doors (nodes with door=* on their walls) or corridors",
                                    .next = "draw the doors, or choose another start room"});
  }
}

const building::Room* Walker::first_room(const building::Building& building) {
  if (!options_.start_room.empty()) return &building.room(options_.start_room);
  std::vector<const building::Room*> named;
  for (const building::Room& room : building.rooms()) {
    const bool on_level = options_.levels.empty() || std::find(options_.levels.begin(), options_.levels.end(),
                                                               room.level) != options_.levels.end();
    if (on_level && room.kind == building::RoomKind::Room) named.push_back(&room);
  }
  if (named.empty()) {
    throw Error(ErrorCode::NotFound, {.what = "nobody can walk in " + building.name() + ": it has no room" +
                                              (options_.levels.empty() ? "" : " on the levels that were asked for"),
                                      .where = building.name(),
                                      .expected = "closed ways with indoor=room and a level",
                                      .next = "draw rooms, or ask for other levels"});
  }
  return named[random_.below(named.size())];
}

std::vector<const building::Room*> Walker::reachable_rooms(const building::Building& building) const {
  std::vector<const building::Room*> rooms;
  for (const building::Room& room : building.rooms()) {
    const bool on_level = options_.levels.empty() || std::find(options_.levels.begin(), options_.levels.end(),
                                                               room.level) != options_.levels.end();
    const bool stays = room.kind == building::RoomKind::Room || room.kind == building::RoomKind::Area;
    if (!on_level || !stays || &room == goal_) continue;
    if (building.route(*goal_, room, options_.routes)) rooms.push_back(&room);
  }
  if (!rooms.empty()) rooms.push_back(goal_);
  return rooms;
}

void Walker::choose_goal() {
  for (std::size_t i = 0; i < kMostTries; ++i) {
    const building::Room* next = rooms_[random_.below(rooms_.size())];
    building::RouteOptions routes = options_.routes;
    if (random_.uniform() < options_.lift_share && routes.lift) routes.stairs = false;
    if (next == goal_) continue;
    const Truth& at = truth();
    auto route = building_.route({{at.x_m, at.y_m}, goal_->level}, {next->centre, next->level}, routes);
    if (!route) route = building_.route({{at.x_m, at.y_m}, goal_->level}, {next->centre, next->level}, options_.routes);
    if (!route) continue;
    goal_ = next;
    const double share = random_.uniform();
    const auto span = static_cast<double>((options_.longest_pause - options_.shortest_pause).count());
    pedestrian_.follow(*route, options_.shortest_pause + milliseconds(static_cast<std::int64_t>(share * span)));
    return;
  }
}

void Walker::advance(milliseconds to) {
  while (truth().t + Pedestrian::kTick <= to) {
    if (pedestrian_.idle()) choose_goal();
    pedestrian_.step();
  }
}

}  // namespace fiona::simulator
