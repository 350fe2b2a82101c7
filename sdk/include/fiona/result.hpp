#pragma once

#include <cassert>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

namespace fiona {

/// How a call ended (patterns.md, rules shared by all). A value, not an exception: the caller branches on it. Links
/// carry its number (wire-protocol.md): a new one comes last.
enum class Outcome {
  Ok,
  NoData,        ///< nothing has arrived yet
  Timeout,       ///< the deadline passed
  Cancelled,     ///< a cancel flag was set
  Disconnected,  ///< the provider went away, or the port was unwired while the call waited
  Unwired,       ///< the port has no wire
  NotActive,     ///< the provider's mode does not serve this port
  WrongId,       ///< the id names no open request
  Rejected,      ///< the provider's hull or component refused, with a reason
};

/// The outcome as `timeout`, `not_active`, …: the spelling of logs, the console and the wire.
std::string_view to_string(Outcome outcome);

/// Either a value or the outcome that took its place. Never throws by itself; `value()` on a failure asserts.
template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : value_(std::move(value)) {}
  Result(Outcome outcome, std::string reason = {}) : outcome_(outcome), reason_(std::move(reason)) {
    assert(outcome != Outcome::Ok);
  }

  bool ok() const { return value_.has_value(); }
  explicit operator bool() const { return ok(); }
  Outcome outcome() const { return outcome_; }
  /// Why, where the provider or the hull said so, or of the connection that it comes from; empty otherwise.
  const std::string& reason() const { return reason_; }

  const T& value() const { return assert(ok()), *value_; }
  T& value() { return assert(ok()), *value_; }
  const T& operator*() const { return value(); }
  const T* operator->() const { return &value(); }

 private:
  std::optional<T> value_;
  Outcome outcome_ = Outcome::Ok;
  std::string reason_;
};

}  // namespace fiona
