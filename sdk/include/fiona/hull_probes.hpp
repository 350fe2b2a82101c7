#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>

namespace fiona {

class Hull;
class Port;
class Task;

/// A probe that each hull has without the component's help: of the instance ("mode"), of each port ("location.rate") or
/// of each task ("steer.overruns").
struct HullProbe {
  enum class Of { Instance, Port, Task };
  using Value = std::variant<double, std::int64_t, std::string>;

  Of of;
  std::string_view name;
  std::string_view type;
  std::string_view unit;
  std::string_view doc;
  /// [any thread] The value of now, from what the hull counts anyway; of a port or task, that one. Null: the hull tells
  /// each change by itself.
  std::optional<Value> (*read)(const Hull& hull, Port* port, const Task* task);
};

/// All of them: the one place that names them.
std::span<const HullProbe> hull_probes();

}  // namespace fiona
