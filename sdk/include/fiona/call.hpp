#pragma once

#include <coroutine>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "fiona/clock.hpp"
#include "fiona/result.hpp"
#include "fiona/strand.hpp"

namespace fiona {

/// The deadline of a call that names none (docs/patterns.md, Shared rules).
inline constexpr Duration kDefaultDeadline = std::chrono::seconds(2);

namespace detail {

/// One call of a component that waits, for a message, an answer, an event. What comes first ends it, once.
struct Call {
  Outcome outcome = Outcome::NoData;
  std::string reason;
  bool ended = false;
  std::uint64_t since = 0;  ///< `RequiredPort::changes` when it was put

 private:
  friend class Calls;
  std::coroutine_handle<> caller;
  TimerId deadline = 0;
};

/// The calls of one port that wait. All functions [strand].
class Calls {
 public:
  /// It is ended by somebody else.
  static constexpr Duration kNoDeadline = Duration::max();

  Calls(Clock& clock, std::shared_ptr<Strand> strand) : clock_(clock), strand_(std::move(strand)) {}

  /// Suspends `caller` until the call ends; with Timeout after `within`. A call that has ended before resumes by a job
  /// of its own, so that a component which asks again and again leaves room for others.
  void suspend(const std::shared_ptr<Call>& call, std::coroutine_handle<> caller, Duration within);
  /// Ends the call, if it has not ended, and resumes who waits for it.
  void finish(const std::shared_ptr<Call>& call, Outcome outcome, std::string reason = {});
  /// Ends all that wait now and were put before this change of the connection; what they start while they are resumed
  /// is none of them.
  void finish_all(Outcome outcome, const std::string& reason = {},
                  std::uint64_t before = std::numeric_limits<std::uint64_t>::max());
  std::size_t size() const { return waiting_.size(); }

 private:
  Clock& clock_;
  const std::shared_ptr<Strand> strand_;
  std::vector<std::shared_ptr<Call>> waiting_;
};

/// Awaits a call. Always a named variable: g++ 12 destroys an aggregate that is awaited as a temporary twice.
struct CallAwaiter {
  CallAwaiter(Calls& of, std::shared_ptr<Call> one, Duration most) : calls(of), call(std::move(one)), within(most) {}
  Calls& calls;
  std::shared_ptr<Call> call;
  Duration within;
  bool await_ready() const { return false; }
  void await_suspend(std::coroutine_handle<> caller) { calls.suspend(call, caller, within); }
  Outcome await_resume() const { return call->outcome; }
};

}  // namespace detail
}  // namespace fiona
