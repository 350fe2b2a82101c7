#pragma once

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "web_request.hpp"

namespace fiona::smart_web_interface {

// What a page asks for, read from its JSON.

struct OpenSession {
  std::string token;
  std::string number;  ///< the page's own: see PageSessions
};
struct FollowEvents {};
struct GetMap {};
struct GetMe {};
struct Login {
  std::string name;
  std::string password;
};
struct Logout {};
struct SetProfile {
  std::optional<bool> use_elevator, use_stairs, use_outdoor_navigation;  ///< none: not said
};
struct Point {
  double x = 0, y = 0, level = 0;
  std::string name;
};
struct SetPoints {
  std::vector<Point> points;
};
struct SetDestination {
  Point to;
};

struct GetSystem {};
struct Rewire {
  std::string client, provider;  ///< "nav.location", "wifi.location"
};

using PageCall = std::variant<OpenSession, FollowEvents, GetMap, GetMe, Login, Logout, SetProfile, SetPoints,
                              SetDestination, GetSystem, Rewire>;

/// The user's level that a call takes: those of consoles for what consoles do too (docs/remote.md), 0 for the guest's.
int level_of(const PageCall& call);

/// Reads the body of a call; overwrites what it holds of passwords, in the body too.
std::variant<PageCall, Refusal> read_call(ApiCall& call);

}  // namespace fiona::smart_web_interface
