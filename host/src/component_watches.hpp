#pragma once

#include <deque>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "samples.hpp"
#include "system.hpp"

namespace fiona::host {

/// What components watch of others. Who watches fetches one value after the other; what comes meanwhile is kept, and of
/// that a bounded number: a slow one loses the oldest, counted. All functions [control thread].
class ComponentWatches {
 public:
  explicit ComponentWatches(System& system) : system_(system) {}
  ComponentWatches(const ComponentWatches&) = delete;
  ComponentWatches& operator=(const ComponentWatches&) = delete;

  /// Begins; the number of `asked` names it from now on. Throws Error: there is nothing to see, or too much watched.
  void watch(const wire::Asked& asked);
  /// The next value, or why none comes any more; none: answered once there is one.
  std::optional<control::Reply> next(const wire::Asked& asked);
  void unwatch(const std::string& instance, std::uint64_t watch) { end({instance, watch}); }

  void on_event(const wire::GroupMessage& event);
  /// Those of components that have been unloaded.
  void end_left();

 private:
  using Id = std::pair<std::string, std::uint64_t>;  ///< of the component that watches, and its number
  struct Watch {
    std::uint64_t tap = 0;
    std::string life{};  ///< of who watches
    Gaps gaps{};
    std::deque<control::Sample> kept{};  ///< the first may have been told, and not have arrived
    std::size_t kept_bytes = 0;
    std::uint64_t last = 0;  ///< number of the newest
    std::uint64_t told = 0;  ///< the number of the last that was given
    /// The last that was given and is kept no more: where it has not arrived, so many are missing.
    std::uint64_t given = 0;
    std::uint64_t given_missing = 0;
    std::optional<control::Failure> over{};
    std::optional<wire::Asked> waiting{};
  };

  void take(const wire::Tapped& tapped);
  bool is_left(const Id& id) const;
  static void drop_oldest(Watch& watch);
  void end(const Id& id);
  void forget(const std::string& instance);

  System& system_;
  std::map<Id, Watch> watches_;
  std::map<std::uint64_t, Id> of_tap_;
};

}  // namespace fiona::host
