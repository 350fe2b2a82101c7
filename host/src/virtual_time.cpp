#include "virtual_time.hpp"

#include <fmt/format.h>

namespace fiona::host {

VirtualTime::VirtualTime(VirtualClock& clock, std::string endpoint, ClockMaster::Frames frames,
                         std::chrono::milliseconds standstill)
    : clock_(clock), master_(clock, std::move(endpoint), std::move(frames)), standstill_(standstill) {}

ClockMaster& VirtualTime::lead_groups() {
  clock_.lead(master_);
  return master_;
}

void VirtualTime::record_to(std::shared_ptr<DeliveryLog> log) {
  log_ = std::move(log);
  clock_.set_recorder(log_);
  master_.set_recorder(log_);
}

void VirtualTime::settle(const std::function<void()>& serve) {
  if (clock_.released() || progress() == unsettled_) return;
  const auto end = std::chrono::steady_clock::now() + standstill_;
  // The groups wait until what they told has been heard.
  do {
    serve();
    if (clock_.settle(master_.empty() ? standstill_ : std::chrono::milliseconds(1))) return;
  } while (std::chrono::steady_clock::now() < end);
  unsettled_ = progress();
}

std::optional<Error> VirtualTime::failure() {
  if (!clock_.released()) {
    standing_ = {0, std::chrono::steady_clock::now(), false};
    instant_ = {TimePoint::min(), 0, {}};
    return std::nullopt;
  }
  if (log_ && !log_->failure().empty()) return unwritable();
  const bool turns = turns_in_one_instant();
  return turns || stands_too_long() ? std::optional(standstill(turns)) : std::nullopt;
}

/// Handlers that put to each other without time between them let it go on no more than one that does not end.
bool VirtualTime::turns_in_one_instant() {
  const auto now = std::chrono::steady_clock::now();
  if (clock_.now() != instant_.at) instant_ = {clock_.now(), progress(), now};
  if (progress() - instant_.progress < kMostInOneInstant || now - instant_.since < standstill_) return false;
  instant_ = {clock_.now(), progress(), now};
  return true;
}

bool VirtualTime::stands_too_long() {
  const auto now = std::chrono::steady_clock::now();
  const bool waits = !clock_.busy_strands().empty() || !master_.situation().quiet;
  if (!waits || progress() != standing_.progress) {
    standing_ = {progress(), now, false};
    return false;
  }
  if (!standing_.asked && now - standing_.since > standstill_ * 4 / 5) {
    standing_.asked = true;
    master_.ask_what_runs();
  }
  if (now - standing_.since < standstill_) return false;
  standing_ = {progress(), now, false};
  return true;
}

Error VirtualTime::unwritable() {
  const Error error(ErrorCode::Failed, {.what = "the delivery log cannot be written",
                                        .where = log_->file().string(),
                                        .found = log_->failure(),
                                        .next = "make room or correct the rights there, then ask for it again"});
  record_to(nullptr);
  return error;
}

Error VirtualTime::standstill(bool turns) {
  std::vector<std::string> blockers;
  for (const auto& name : clock_.busy_strands()) blockers.push_back("'" + name + "' runs");
  for (auto& text : master_.blockers()) blockers.push_back(std::move(text));
  return Error(
      ErrorCode::Unreachable,
      {.what = fmt::format("virtual time has stood at {:.3f} s for {:.3g} s", to_seconds(clock_.now() - clock_.start()),
                           std::chrono::duration<double>(standstill_).count()),
       .expected = turns ? "handlers that do not put to each other without end in one instant"
                         : "a handler that ends: time goes on when nothing runs",
       .found = fmt::format("{}", fmt::join(blockers, "; ")),
       .next = "show the instance, or unload it; then wait again"});
}

}  // namespace fiona::host
