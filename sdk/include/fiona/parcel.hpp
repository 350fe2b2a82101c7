#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "fiona/message.hpp"
#include "fiona/result.hpp"

namespace fiona {

/// Where the answer to a request goes. Shared by the request under way and whoever will answer it.
class ReplySink {
 public:
  virtual ~ReplySink() = default;
  /// [any thread] Ends the request; only the first call counts.
  virtual void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) = 0;
  /// [any thread] Of an activation: one event. Without an object and number, that the provider has taken it; without an
  /// object alone, that this one was refused on the way.
  virtual Outcome event(Envelope /*event*/) { return Outcome::WrongId; }
  /// [any thread] The client gave up or is gone: nobody reads the answer.
  bool abandoned() const { return abandoned_.load(std::memory_order_acquire); }
  /// [any thread] The same, though the provider may not know it yet.
  bool given_up() const { return given_up_.load(std::memory_order_acquire); }
  void abandon() {
    if (given_up_.exchange(true)) return;
    if (!in_turn_) note_abandoned();
    if (on_abandon_) on_abandon_();
  }
  void note_abandoned() { abandoned_.store(true, std::memory_order_release); }
  /// [before the request leaves] What tells the provider that nobody waits any more; `in_turn`: and calls
  /// `note_abandoned` when its turn has come.
  void set_on_abandon(std::function<void()> notice, bool in_turn = false) {
    on_abandon_ = std::move(notice);
    in_turn_ = in_turn;
  }
  /// [strand of the provider] While its handler runs: if that throws, who called the handler answers.
  void set_in_handler(bool in_handler) { in_handler_.store(in_handler, std::memory_order_relaxed); }
  bool in_handler() const { return in_handler_.load(std::memory_order_relaxed); }

 private:
  std::atomic<bool> in_handler_{false};
  std::atomic<bool> given_up_{false};
  std::atomic<bool> abandoned_{false};
  std::function<void()> on_abandon_;
  bool in_turn_ = false;
};

/// A message on its way into an inbox: with `reply`, a request.
struct Parcel {
  Envelope envelope;
  std::shared_ptr<ReplySink> reply;
  bool continuous = false;       ///< of an activation: each event, not the first only
  std::uint64_t activation = 0;  ///< of an event: which activation of the client's it is for

  /// Whether somebody waits for an answer to it.
  bool is_request() const { return reply && activation == 0; }
};

}  // namespace fiona
