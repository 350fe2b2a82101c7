#pragma once

#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "fiona/clock.hpp"
#include "fiona/control.pb.h"
#include "fiona/error.hpp"
#include "fiona/wire.pb.h"
#include "types.hpp"

namespace fiona::host {

/// Requests whose answer comes when something has happened in the system: a mode reached, a value seen, a time passed,
/// the run ended. While one is open a virtual clock runs; the moment it is met the clock is held, so that a script
/// goes on at exactly that instant.
class Waits {
 public:
  using Answer = std::function<void(control::Reply)>;  ///< [any thread]

  Waits(Clock& clock, Executor& executor);
  ~Waits();
  /// Lets go of the executor: what is timed does not end any more.
  void stop() { strand_->close(); }

  void wait_mode(std::uint64_t owner, std::uint64_t id, const control::WaitMode& request, Answer answer);
  /// `begin` makes the tap of that number; what it delivers is offered to `on_event`, which may be before `begin` ends.
  void expect(std::uint64_t owner, std::uint64_t id, const control::Expect& request, std::uint64_t tap,
              const std::function<void()>& begin, Answer answer);
  void sleep(std::uint64_t owner, std::uint64_t id, const control::Sleep& request, Answer answer);
  void run(std::uint64_t owner, std::uint64_t id, Answer answer);
  /// What `begin` starts, and an event ends: the first that `end_of` makes a reply of; after `within_ms`, `expired`.
  /// `given_up`: once it is dropped.
  using EndOf = std::function<std::optional<control::Reply>(const wire::GroupMessage& event)>;
  void work(std::uint64_t owner, std::uint64_t id, double within_ms, const std::function<void()>& begin, EndOf end_of,
            control::Reply expired, Answer answer, std::function<void()> given_up = nullptr);

  /// [any thread] Something has happened.
  void on_event(const wire::GroupMessage& event, const Types& types);
  /// The owner has gone: its waits end without an answer; with an id only that one. False: there was none.
  bool drop(std::uint64_t owner, std::optional<std::uint64_t> id = std::nullopt);
  /// One ends now, with this reply.
  void end(std::uint64_t owner, std::uint64_t id, const control::Reply& reply);
  /// Who waits for the end of the run, on whatever clock, and what there is to say of it.
  struct Runs {
    struct Run {
      std::uint64_t owner = 0;
      std::uint64_t id = 0;
      Answer answer{};
    };
    std::vector<Run> open{};
    std::optional<control::Reply> end{};
    std::set<std::uint64_t> told{};
  };
  /// They wait here no more; every other wait ends with this error.
  Runs leave(const Error& error);
  /// They wait here from now on.
  void take(Runs runs);
  /// Nothing can be waited for: every wait ends with this error.
  void fail_all(const Error& error);
  /// The run has ended: every wait is answered. Who is there and does not wait for that is told at the next `run` or
  /// `sleep`, once.
  /// An exit code that no process can have is 255.
  void end_run(int exit_code, const std::string& reason);
  /// A new owner: to whom an end that came before is no news.
  void meet(std::uint64_t owner);

 private:
  struct Wait;
  using WaitPtr = std::shared_ptr<Wait>;

  WaitPtr add(std::uint64_t owner, std::uint64_t id, Answer answer);
  void time_out_after(const WaitPtr& wait, double within_ms, std::function<control::Reply()> reply);
  /// False: it had ended before.
  bool finish(const WaitPtr& wait, std::optional<control::Reply> reply);
  void end_all(const control::Reply& reply);
  std::vector<WaitPtr> of(std::uint64_t owner, std::optional<std::uint64_t> id);
  double elapsed_ms(const Wait& wait) const;
  std::optional<control::Reply> reply_to_mode(const Wait& wait, const wire::ModeChanged& changed) const;
  std::optional<control::Reply> reply_to_value(Wait& wait, const wire::Tapped& tapped, const Types& types) const;
  void let_run(const WaitPtr& wait);
  bool tell_end(const WaitPtr& wait);
  void cancel(TimerId timer);

  Clock& clock_;
  VirtualClock* const virtual_;
  const std::shared_ptr<Strand> strand_;
  std::mutex mutex_;
  std::list<WaitPtr> waits_;
  std::optional<control::Reply> end_;  ///< of the run, since it has come
  std::set<std::uint64_t> told_;       ///< of that
};

/// A refusal as a reply.
control::Reply failure_reply(ErrorCode code, ErrorText text);

}  // namespace fiona::host
