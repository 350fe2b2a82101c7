#include "page_calls.hpp"

#include <sodium.h>

#include <cmath>
#include <nlohmann/json.hpp>

namespace fiona::smart_web_interface {
namespace {

using nlohmann::json;

/// Thrown within this file.
struct Fault {
  std::string text;
};

constexpr std::size_t kMaxText = 1024;
constexpr std::size_t kMaxPoints = 256;
constexpr double kFurthest_m = 1e6;

void wipe(std::string& text) { sodium_memzero(text.data(), text.size()); }

json& member(json& object, const char* name) {
  const auto found = object.find(name);
  if (found == object.end()) throw Fault{std::string("'") + name + "' is missing"};
  return *found;
}

std::string text(json& object, const char* name) {
  json& value = member(object, name);
  if (!value.is_string()) throw Fault{std::string("'") + name + "' is no text"};
  auto& found = value.get_ref<std::string&>();
  std::string copy = found;
  wipe(found);
  if (copy.size() > kMaxText) throw Fault{std::string("'") + name + "' is longer than 1024 bytes"};
  return copy;
}

double number(json& object, const char* name) {
  const json& value = member(object, name);
  const double found = value.is_number() ? value.get<double>() : NAN;
  if (!std::isfinite(found) || std::abs(found) > kFurthest_m)
    throw Fault{std::string("'") + name + "' is no coordinate"};
  return found;
}

std::optional<bool> choice(json& object, const char* name) {
  const json& value = member(object, name);
  if (value.is_null()) return std::nullopt;
  if (!value.is_boolean()) throw Fault{std::string("'") + name + "' is neither true, false nor null"};
  return value.get<bool>();
}

Point point(json& object) {
  if (!object.is_object()) throw Fault{"a point is no object"};
  return {number(object, "x"), number(object, "y"), number(object, "level"),
          object.contains("name") ? text(object, "name") : std::string()};
}

SetPoints points(json& body) {
  json& list = member(body, "points");
  if (!list.is_array() || list.size() > kMaxPoints) throw Fault{"'points' is no list of 256 points at most"};
  SetPoints call;
  for (json& one : list) call.points.push_back(point(one));
  return call;
}

PageCall read(const std::string& name, json& body) {
  if (name == "session") return OpenSession{text(body, "token"), text(body, "number")};
  if (name == "events") return FollowEvents{};
  if (name == "map") return GetMap{};
  if (name == "me") return GetMe{};
  if (name == "login") return Login{text(body, "name"), text(body, "password")};
  if (name == "logout") return Logout{};
  if (name == "points") return points(body);
  if (name == "destination") return SetDestination{point(body)};
  if (name == "system") return GetSystem{};
  if (name == "rewire") return Rewire{text(body, "client"), text(body, "provider")};
  return SetProfile{choice(body, "use_elevator"), choice(body, "use_stairs"), choice(body, "use_outdoor_navigation")};
}

// A kind of call without a line here does not compile.
constexpr int kObserve = 1;
constexpr int kCompose = 6;
struct Levels {
  int operator()(const OpenSession&) const { return 0; }
  int operator()(const FollowEvents&) const { return 0; }
  int operator()(const GetMap&) const { return 0; }
  int operator()(const GetMe&) const { return 0; }
  int operator()(const Login&) const { return 0; }
  int operator()(const Logout&) const { return 0; }
  int operator()(const SetProfile&) const { return 0; }
  int operator()(const SetPoints&) const { return 0; }
  int operator()(const SetDestination&) const { return 0; }
  int operator()(const GetSystem&) const { return kObserve; }
  int operator()(const Rewire&) const { return kCompose; }
};

}  // namespace

int level_of(const PageCall& call) { return std::visit(Levels(), call); }

std::variant<PageCall, Refusal> read_call(ApiCall& call) {
  json body = json::parse(call.body, nullptr, false);
  wipe(call.body);
  if (!body.is_object()) return Refusal{400, "the request is no JSON object"};
  try {
    return read(call.name, body);
  } catch (const Fault& fault) {
    return Refusal{400, fault.text};
  }
}

}  // namespace fiona::smart_web_interface
