// The clock that a system lives by.
#include "fiona/error.hpp"
#include "system.hpp"

namespace fiona::host {

void System::set_clock(const ClockSettings& next) {
  if (next.is_virtual && hosts_) {
    throw Error(ErrorCode::NotAllowed,
                {.what = "a virtual clock drives one host, and this one works with others over tcp",
                 .next = "start it without --listen and --peer"});
  }
  auto log = virtual_time_ ? virtual_time_->log() : nullptr;
  const bool is_same = next.deliveries == (virtual_time_ ? virtual_time_->deliveries() : "");
  if (!is_same)  // first: a file that cannot be written changes nothing
    log = next.deliveries.empty() ? nullptr : std::make_shared<DeliveryLog>(next.deliveries);
  const bool stays = next.is_virtual == has_virtual_clock() && (!next.is_virtual || clock_->start() == next.start);
  std::optional<Waits::Runs> runs;
  if (!stays)
    runs = waits_->leave(Error(ErrorCode::Failed, {.what = "the clock that was waited by has been changed",
                                                   .next = "ask again: it is waited by the one of now"}));
  if (!stays && next.is_virtual) use_clock(std::make_unique<VirtualClock>(next.start));
  if (!stays && !next.is_virtual) use_clock(std::make_unique<SystemClock>());
  if (virtual_time_) virtual_time_->clock().set_speed(next.speed);
  if (virtual_time_ && virtual_time_->log() != log) {
    if (log && is_same) log->begin_anew();
    virtual_time_->record_to(std::move(log));
  }
  if (runs) waits_->take(std::move(*runs));  // last: it lets time go on
}

void System::settle() {
  if (!virtual_time_) return;
  virtual_time_->settle([this] {
    for (auto* child : child_groups()) serve_group(*child);
  });
}

void System::watch_time() {
  if (!virtual_time_) return;
  if (const auto failure = virtual_time_->failure()) waits_->fail_all(*failure);
}

}  // namespace fiona::host
