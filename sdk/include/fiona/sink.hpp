#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "fiona/parcel.hpp"
#include "fiona/result.hpp"
#include "fiona/time.hpp"

namespace fiona {

/// The far end of a wire as the near end sees it: an inbox of the same process, or a link to another.
class Sink {
 public:
  virtual ~Sink() = default;
  /// [any thread] Takes the message or says why not. Never waits, never runs a handler on the caller's stack.
  virtual Outcome deliver(Parcel parcel) = 0;
  /// [any thread] What was put last is still valid: it is given again, whatever share of all the wire takes.
  virtual void repeat(Parcel parcel) { deliver(std::move(parcel)); }
  /// [any thread] Whether a push provider speaks, or has been silent for longer than its lease.
  virtual void lease(bool /*held*/, const std::string& /*reason*/) {}
  /// [any thread] It subscribes to a push provider now, and is given what comes after this sequence number. `cycle`: of
  /// a push timed; zero: there is none.
  virtual void attached(std::uint64_t /*sequence*/, Duration /*cycle*/) {}
  /// [any thread] How many subscribers it stands for.
  virtual std::size_t subscribers() const { return 1; }
  /// [strand of a push provider] Whether a message of so many bytes finds room in front of the handler of each
  /// subscriber that receives each one. If not, `notice` is called [any thread] when that may have changed.
  virtual bool has_room(std::size_t /*bytes*/, const std::function<void()>& /*notice*/) { return true; }
};

/// What a push provider knows of the room in front of a subscriber's handler: what that has said, less what it was sent
/// since it was asked. Not synchronised.
class KnownRoom {
 public:
  bool holds(std::size_t cost) const { return known_ >= cost; }
  /// False if it has been asked already, and has not answered.
  bool ask() {
    if (std::exchange(asked_, true)) return false;
    since_asked_ = 0;
    return true;
  }
  void sent(std::size_t cost) {
    known_ -= std::min(known_, cost);
    since_asked_ += cost;
  }
  /// False if it was not asked.
  bool told(std::size_t room) {
    if (!std::exchange(asked_, false)) return false;
    known_ = room - std::min(room, since_asked_);
    return true;
  }

 private:
  std::size_t known_ = 0;
  std::size_t since_asked_ = 0;
  bool asked_ = false;
};

/// What a delivery log says of a delivery that has no object.
inline constexpr std::string_view kGivenUp = "given_up";
inline constexpr std::string_view kSpeaks = "speaks";
inline constexpr std::string_view kSilent = "silent";
inline constexpr std::string_view kTaken = "taken";
inline constexpr std::string_view kAsksRoom = "asks_room";
inline constexpr std::string_view kHasRoom = "room";

namespace detail {

/// Where the messages of a send, query or event client go. [any thread]
class Target {
 public:
  void set(std::shared_ptr<Sink> sink);
  /// Hands the message over; none: there is nowhere to go. What meets a wire that another has just replaced goes to
  /// that other one.
  std::optional<Outcome> deliver(const Parcel& parcel);

 private:
  std::shared_ptr<Sink> get();

  std::mutex mutex_;
  std::shared_ptr<Sink> sink_;
};

}  // namespace detail

}  // namespace fiona
