#pragma once

#include <concepts>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>

#include "fiona/async.hpp"
#include "fiona/call.hpp"
#include "fiona/control.pb.h"
#include "fiona/probe.pb.h"
#include "fiona/result.hpp"
#include "fiona/typed_value.hpp"

namespace fiona {

class Master;

/// Conditions of what is watched: told is the value with which one becomes true. `field` is of an object that is
/// watched
/// ("position.z"); empty: the value of a probe.
namespace when {

control::Condition compared(control::Comparison comparison, control::Value value, std::string_view field);
inline control::Condition above(double bound, std::string_view field = {}) {
  return compared(control::GREATER, detail::typed_value(bound), field);
}
inline control::Condition below(double bound, std::string_view field = {}) {
  return compared(control::LESS, detail::typed_value(bound), field);
}
/// A number, a flag, a text, or the name of an enumerator.
template <class T>
control::Condition is(const T& value, std::string_view field = {}) {
  return compared(control::EQUAL, detail::typed_value(value), field);
}
/// Each value that differs from the one before.
control::Condition changes(std::string_view field = {});
/// Nothing new has come for so long.
control::Condition older_than(Duration age);

}  // namespace when

/// How something is watched; docs/patterns.md, Monitoring.
struct WatchTerms {
  std::uint32_t every = 1;                      ///< each n-th value
  Duration period{};                            ///< at most one in that time; of what the hull samples: its period
  std::optional<control::Condition> when = {};  ///< event mode
};

/// What a sample holds; none: it holds no value yet, or one of another type. `T`: a number, bool, std::string (also for
/// the name of an enumerator), or the message that is watched.
template <class T>
std::optional<T> value_of(const control::Sample& sample) {
  const auto read = [&sample](auto carrier) -> std::optional<decltype(carrier)> {
    const bool fits = sample.type() == carrier.GetDescriptor()->full_name() && carrier.ParseFromString(sample.object());
    return fits ? std::optional(std::move(carrier)) : std::nullopt;
  };
  if constexpr (std::derived_from<T, google::protobuf::Message>) {
    return read(T());
  } else if constexpr (std::is_same_v<T, bool>) {
    if (const auto flag = read(probe::Flag())) return flag->value();
  } else if constexpr (std::is_arithmetic_v<T>) {
    if (const auto number = read(probe::Number())) return static_cast<T>(number->value());
    if (const auto integer = read(probe::Integer())) return static_cast<T>(integer->value());
  } else {
    if (const auto text = read(probe::Text())) return text->value();
  }
  return std::nullopt;
}

/// A watch of a probe or a push port of any instance, made by `Master::watch`; it ends with its last copy, and with its
/// component. [strand]
class Watch {
 public:
  /// The next value, in its order, with what is missing before it (`skipped`): 64 that nobody has fetched are kept, and
  /// 4 MiB of them. Outcomes: Rejected, with why the watch is over (the instance was unloaded, its process has ended,
  /// the condition does not fit); Timeout and NotActive, after which it goes on, and nothing is lost; Cancelled.
  Async<Result<control::Sample>> next(Duration deadline = kDefaultDeadline) const;
  /// Lets go of it.
  void stop() { state_.reset(); }

 private:
  friend class Master;
  struct State;
  explicit Watch(std::shared_ptr<State> state) : state_(std::move(state)) {}
  static Async<Result<control::Sample>> next_of(std::shared_ptr<State> state, Duration deadline);

  std::shared_ptr<State> state_;
};

}  // namespace fiona
