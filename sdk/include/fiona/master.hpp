#pragma once

#include <concepts>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "fiona/async.hpp"
#include "fiona/call.hpp"
#include "fiona/control.pb.h"
#include "fiona/result.hpp"
#include "fiona/typed_value.hpp"
#include "fiona/watch.hpp"

namespace fiona {

class Component;
class Hull;

namespace detail {

/// As it is typed: "nav.location", "nav.location.rate".
control::PortName port_name(std::string_view text);

}  // namespace detail

/// What more there is to say of a wire.
struct WireChoice {
  std::vector<std::string> otherwise = {};  ///< who serves while those before are not fit, in their order
  std::uint32_t every = 0;                  ///< each n-th message of a push; 0: as so far, or 1
  std::optional<Duration> hold = {};        ///< before a better one serves again; none: as so far, or 3 s
};

/// Changes of the system that are made together, each what a line of the console asks for. Ports are named as there:
/// "nav.location".
///
///     fiona::Changes().wire("nav.location", "wifi.location").set("wifi", "period", 200, "ms").state("gps", "neutral")
class Changes {
 public:
  /// Connects a required port to a provided one, in the place of the wire that it has.
  Changes& wire(std::string_view client, std::string_view provider, const WireChoice& choice = {});
  /// Takes the wire of a required port away, with those to its alternatives.
  Changes& unwire(std::string_view client);
  /// All who use `old` use `next`.
  Changes& swap(std::string_view old, std::string_view next);
  /// Brings an instance into a mode: `neutral`, `deactivated` or a main mode of its component.
  Changes& state(std::string_view instance, std::string_view mode);
  /// Makes an instance of a plugin ("acme/lidar") in a group, with its default parameters, in its first main mode.
  Changes& load(std::string_view plugin, std::string_view instance, std::string_view group = "main");
  /// Retires an instance; the wires of its clients wait for another of its name.
  Changes& unload(std::string_view instance);
  /// One parameter: a flag, a number with or without a unit, a text or the name of an enumerator.
  template <class T>
  Changes& set(std::string_view instance, std::string_view parameter, const T& value, std::string_view unit = {}) {
    control::Value typed = detail::typed_value(value);
    typed.set_unit(std::string(unit));
    return set_value(instance, parameter, std::move(typed));
  }
  /// What has no function of its own here.
  Changes& add(control::Change change);

  const std::vector<control::Change>& list() const { return list_; }

 private:
  Changes& set_value(std::string_view instance, std::string_view parameter, control::Value value);
  control::Change& next() { return list_.emplace_back(); }

  std::vector<control::Change> list_;
};

/// Changes the system that the component is part of, and looks at others: the right `master` (document 2.1.3.8
/// and 2.1.3.9). A component that has this member asks for the right; its package's manifest says so too (`rights:
/// "master"`), and who loads it grants it: `load fiona/chooser with master`.
///
///     fiona::Master master_{*this};
///     auto done = co_await master_.wire("nav.location", "wifi.location");
///     if (!done) log(LogLevel::Warning, done.reason());
///
/// Each call is one transaction of the host's engine, beside those of consoles: all its changes are made or none, the
/// journal names the component as their author, and `undo` takes them back. All functions [strand]. Outcomes: the
/// host's answer; Rejected, with a sentence, also when the right was not granted; NotActive outside of a main mode;
/// Cancelled; Timeout, after which the change may still be made if it had begun. The answer to what ends the
/// component itself (its own `unload`) reaches nobody. A change of its own mode waits for the handlers that hold the
/// mode, the one that asks among them: ask for it from a coroutine of no handler (`spawn`).
/// On a virtual clock the deadline does not count, and the change happens at no exact instant.
class Master {
 public:
  /// Calls that may be open at once.
  static constexpr std::size_t kMaxOpen = 64;

  explicit Master(Component& owner);
  ~Master() { *self_ = nullptr; }
  Master(const Master&) = delete;
  Master& operator=(const Master&) = delete;

  /// Makes the changes, in their order, or none of them: what was done, and what it cost.
  Async<Result<control::Done>> make(Changes changes, Duration deadline = kDefaultDeadline);
  /// What would be done, and what would take it back; changes nothing.
  Async<Result<control::Planned>> plan(Changes changes, Duration deadline = kDefaultDeadline);
  /// The instances with their ports, wires, modes and parameters.
  Async<Result<control::System>> system(Duration deadline = kDefaultDeadline);

  /// Begins to watch a probe or a push port of any instance: "gps.satellites", "nav.location.rate", "nav.location".
  ///
  ///     auto few = co_await master_.watch("gps.satellites", {.when = fiona::when::below(4)});
  ///     while (few) {
  ///       const auto seen = co_await few->next(10s);
  ///       if (seen) co_await master_.swap("gps", "wifi");
  ///       if (!seen && seen.outcome() != fiona::Outcome::Timeout) break;    // gps is gone, or this mode was left
  ///     }
  Async<Result<Watch>> watch(std::string_view what, const WatchTerms& terms = {}, Duration deadline = kDefaultDeadline);
  /// A probe's value of now, also when nobody watches it.
  Async<Result<control::Sample>> read(std::string_view probe, Duration deadline = kDefaultDeadline);

  // `make` with one change each.

  /// Connects a required port to a provided one, in the place of the wire that it has.
  Async<Result<control::Done>> wire(std::string_view client, std::string_view provider,
                                    Duration deadline = kDefaultDeadline) {
    return make(std::move(Changes().wire(client, provider)), deadline);
  }
  /// Takes the wire of a required port away.
  Async<Result<control::Done>> unwire(std::string_view client, Duration deadline = kDefaultDeadline) {
    return make(std::move(Changes().unwire(client)), deadline);
  }
  /// All who use `old` use `next`.
  Async<Result<control::Done>> swap(std::string_view old, std::string_view next, Duration deadline = kDefaultDeadline) {
    return make(std::move(Changes().swap(old, next)), deadline);
  }
  /// Brings an instance into a mode.
  Async<Result<control::Done>> state(std::string_view instance, std::string_view mode,
                                     Duration deadline = kDefaultDeadline) {
    return make(std::move(Changes().state(instance, mode)), deadline);
  }

 private:
  friend class Hull;
  friend class fiona::Watch;
  /// What a call waits for: virtual time may be over before the host, which lives by the machine's, has looked at it.
  enum class Waits { ForHost, ForTime };
  struct Open {
    std::shared_ptr<detail::Call> call;
    control::Reply reply;
  };
  Async<Result<control::Reply>> ask(control::Request request, Duration deadline, Waits waits = Waits::ForHost);
  Async<Result<Watch>> begin_watch(control::Request request, Duration deadline);
  Async<Result<control::Sample>> read_by(control::Request request, Duration deadline);
  void unwatch(std::uint64_t watch);
  std::optional<Outcome> obstacle() const;
  void take(std::uint64_t number, control::Reply reply);

  Hull& hull_;
  detail::Calls calls_;
  std::map<std::uint64_t, Open> open_;
  std::uint64_t last_number_ = 0;
  const std::shared_ptr<Master*> self_ = std::make_shared<Master*>(this);  ///< null once it is gone
};

}  // namespace fiona
