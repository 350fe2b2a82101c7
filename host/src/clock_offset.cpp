#include "clock_offset.hpp"

#include <cstdlib>

namespace fiona::host {
namespace {

/// How far two clocks wander apart: a nanosecond in so many.
constexpr std::int64_t kWander_ns = 20'000;
/// A round trip longer than this tells nothing.
constexpr std::int64_t kLongest_ns = 10'000'000'000;

bool is_time(std::int64_t ns) { return ns == told_ns(ns); }

}  // namespace

wire::Beat ClockOffset::beat(std::int64_t now_ns) {
  const std::lock_guard lock(mutex_);
  wire::Beat beat;
  beat.set_now_ns(now_ns);
  beat.set_echo_ns(echo_ns_);
  beat.set_heard_ns(heard_ns_);
  return beat;
}

void ClockOffset::heard(const wire::Beat& beat, std::int64_t now_ns) {
  if (!is_time(beat.now_ns()) || !is_time(beat.heard_ns()) || !is_time(beat.echo_ns())) return;
  const std::lock_guard lock(mutex_);
  echo_ns_ = beat.now_ns();
  heard_ns_ = now_ns;
  if (beat.echo_ns() == 0) return;
  const std::int64_t kept_ns = beat.now_ns() - beat.heard_ns();
  const std::int64_t trip_ns = now_ns - beat.echo_ns() - kept_ns;
  if (kept_ns < 0 || kept_ns > kLongest_ns || trip_ns < 0 || trip_ns > kLongest_ns) return;
  const std::int64_t ahead_ns = ((beat.heard_ns() - beat.echo_ns()) + (beat.now_ns() - now_ns)) / 2;
  const std::int64_t error_ns = trip_ns / 2;
  const std::int64_t best_error_ns = best_ ? best_->error_ns + (now_ns - best_->at_ns) / kWander_ns : 0;
  // Two that cannot both be true: one of the clocks has jumped.
  const bool jumped = best_ && std::abs(ahead_ns - best_->ahead_ns) > error_ns + best_error_ns;
  if (best_ && error_ns > best_error_ns && !jumped) return;
  best_ = Trip{error_ns, ahead_ns, now_ns};
  ahead_ns_ = ahead_ns;
}

std::int64_t ClockOffset::to_ours(std::int64_t theirs_ns) const {
  return is_time(theirs_ns) ? theirs_ns - ahead_ns_ : theirs_ns;
}

void ClockOffset::turn(wire::Frame& frame) const {
  if (frame.has_object()) frame.mutable_object()->set_origin_ns(to_ours(frame.object().origin_ns()));
  if (frame.has_request()) frame.mutable_request()->set_origin_ns(to_ours(frame.request().origin_ns()));
  if (frame.has_fired()) frame.mutable_fired()->set_origin_ns(to_ours(frame.fired().origin_ns()));
}

}  // namespace fiona::host
