#pragma once

#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

namespace fiona {

class Component;
class Hull;

inline constexpr std::string_view kModeInit = "init";
inline constexpr std::string_view kModeNeutral = "neutral";
/// Neutral, and every call that waits is cancelled on the way.
inline constexpr std::string_view kModeDeactivated = "deactivated";
/// The main mode of a component that declares none.
inline constexpr std::string_view kModeActive = "active";
inline constexpr std::string_view kModeFailed = "failed";
inline constexpr std::string_view kModeShutdown = "shutdown";

/// A main mode and the activities, or sub-states, that run in it (document 2.1.3, State pattern).
struct MainMode {
  std::string name;
  std::vector<std::string> activities;
};

/// The main modes of a component, the first of which `load` enters:
///
///     fiona::Modes modes_{*this, {{"navigate", {"localise", "drive"}}, {"stand", {"localise"}}}};
///     fiona::Task steer_{*this, "steer", 100ms, &Self::steer, "drive"};
///     fiona::Requires<PathProvider> path_{*this, "path", {.activity = "drive"}};
///
/// Ports and tasks that name an activity work in the modes that have it, the others in each main mode. Work that waits
/// holds its activity like a read lock: a mode is left when what it leaves is free, and what both modes share goes on.
class Modes {
 public:
  /// Throws Error Usage for a name that is reserved, given twice, or not of letters, digits, '_' and '-'; and where the
  /// component has such a member already.
  Modes(Component& owner, std::initializer_list<MainMode> modes);
  Modes(const Modes&) = delete;
  Modes& operator=(const Modes&) = delete;
};

}  // namespace fiona
