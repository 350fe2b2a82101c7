#include "alarm.hpp"

#include <sys/timerfd.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <system_error>
#include <utility>

namespace fiona::host {
namespace {

os::Descriptor timer() {
  os::Descriptor made(::timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK));
  if (!made) throw std::system_error(errno, std::generic_category(), "timerfd_create");
  return made;
}

}  // namespace

Alarm::Alarm(Pool& pool, std::chrono::nanoseconds after, std::function<void()> ring)
    : after_(after), ring_(std::move(ring)), timer_(timer()), watch_(pool.watch(timer_.get(), [this] { rung(); })) {}

void Alarm::set() {
  if (set_.exchange(true)) return;
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(after_);
  const itimerspec once{{0, 0}, {seconds.count(), (after_ - seconds).count()}};
  ::timerfd_settime(timer_.get(), 0, &once, nullptr);
}

void Alarm::rung() {
  std::uint64_t times = 0;
  if (::read(timer_.get(), &times, sizeof times) < 0) return;
  set_ = false;  // before the call, in which it may be set again
  ring_();
}

}  // namespace fiona::host
