// A person who is led by the navigation component, on the bench.
#pragma once

#include <cmath>
#include <functional>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "fiona/sink.hpp"
#include "fiona/testing/bench.hpp"
#include "fiona/wire_end.hpp"
#include "navigation.hpp"
#include "navigation_world.hpp"

namespace fiona::guidance::world {

using hmi::Instruction;
using hmi::InstructionProvider;
using localisation::CommLocation;
using localisation::LocationProvider;
using namespace std::chrono_literals;

inline CommLocation location(double x, double y, double level, double heading_deg = 0, double sigma_m = 0.1) {
  constexpr double kDegree = std::numbers::pi / 180.0;
  CommLocation told;
  told.set_is_valid(true);
  auto& position = *told.mutable_position();
  position.set_x(x);
  position.set_y(y);
  position.set_z(level);
  position.set_is_valid(true);
  const double var = sigma_m * sigma_m;
  for (double element : {var, 0.0, 0.0, 0.0, var, 0.0, 0.0, 0.0, 0.0}) position.add_confidence(element);
  auto& orientation = *told.mutable_orientation();
  orientation.set_yaw(std::fmod((720 - heading_deg) * kDegree, 2 * std::numbers::pi));
  orientation.set_is_valid(true);
  return told;
}

inline navigation::CommDestination destination(double x, double y, double level) {
  navigation::CommDestination wish;
  wish.mutable_destination()->set_x(x);
  wish.mutable_destination()->set_y(y);
  wish.mutable_destination()->set_z(level);
  wish.mutable_destination()->set_is_valid(true);
  return wish;
}

inline navigation::CommDestination of_user(navigation::CommDestination wish, const std::string& name) {
  wish.set_user_name(name);
  wish.set_session(name + std::string(16 - name.size(), '.'));
  return wish;
}

/// Takes what a required port asks for, in the place of a provider that is not as it should be.
struct Provider final : Sink {
  Outcome deliver(Parcel parcel) override {
    if (on_request) on_request(*parcel.reply);
    asked.push_back(std::move(parcel));
    return Outcome::Ok;
  }
  std::function<void(ReplySink&)> on_request;
  std::vector<Parcel> asked;
};

/// Navigation in the house of the tests, with map, planner and profile on the bench.
struct Led {
  explicit Led(const building::Osm& osm = house()) : map(told(osm.read())) {
    bench.answer_with<navigation::LevelMap>("levels", [this](const auto&) { return map; });
    bench.answer_with<navigation::PlanProvider>("planner", [](const auto& request) { return solve(request); });
    bench.answer_with<hmi::ProfileProvider>("profile", [this](const auto& request) {
      asked = request;
      return profile;
    });
    bench.start();
    paths_at_start = paths();
    said_at_start = said();
  }
  /// Wires a required port to another provider.
  std::shared_ptr<Provider> replace(const char* port, std::function<void(ReplySink&)> on_request = {}) {
    auto provider = std::make_shared<Provider>();
    provider->on_request = std::move(on_request);
    const auto end = dynamic_cast<RequiredPort&>(*bench.hull().find_port(port)).end_for("bench");
    end->set_target(provider);
    end->set_connection(Connection::Connected, "on the bench");
    return provider;
  }
  void unwire(const char* port) {
    const auto end = dynamic_cast<RequiredPort&>(*bench.hull().find_port(port)).end_for("bench");
    end->set_target(nullptr);
    end->set_connection(Connection::Unwired, "on the bench");
  }
  /// From now on the building is as this file says, and who watches it is told.
  void rebuild(const building::Osm& osm) {
    const std::uint64_t version = map.version() + 1;
    map = told(osm.read());
    map.set_version(version);
    tell_of_change(version);
  }
  void tell_of_change(std::uint64_t version) {
    navigation::LevelMapVersion changed;
    changed.set_version(version);
    ASSERT_GT(bench.fire<navigation::LevelMapChange>("map_change", changed), 0u) << "nobody watches the map";
  }
  void stand(const CommLocation& at, Duration time = 600ms) {
    for (Duration passed{}; passed < time; passed += 200ms) {
      bench.put<LocationProvider>("location", at);
      bench.advance(200ms);
    }
  }
  void go_to(const navigation::CommDestination& wish) {
    bench.put<navigation::DestinationProvider>("destination", wish);
  }
  std::vector<Instruction> said() {
    std::vector<Instruction> all;
    for (const auto& one : bench.take<InstructionProvider>("instructions")) all.push_back(*one);
    return all;
  }
  Instruction last() {
    const auto all = said();
    return all.empty() ? Instruction{} : all.back();
  }
  std::vector<navigation::CommPath> paths() {
    std::vector<navigation::CommPath> all;
    for (const auto& one : bench.take<navigation::PathProvider>("path")) all.push_back(*one);
    return all;
  }
  navigation::CommPath last_path() {
    const auto all = paths();
    return all.empty() ? navigation::CommPath{} : all.back();
  }

  testing::Bench<Navigation> bench{"nav"};
  std::vector<navigation::CommPath> paths_at_start;
  std::vector<Instruction> said_at_start;
  navigation::CommLevelMap map;
  hmi::CommUserProfileReply profile;
  hmi::CommUserProfileRequest asked;
};

}  // namespace fiona::guidance::world
