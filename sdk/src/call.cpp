#include "fiona/call.hpp"

#include <algorithm>
#include <utility>

namespace fiona::detail {

void Calls::suspend(const std::shared_ptr<Call>& call, std::coroutine_handle<> caller, Duration within) {
  if (call->ended) {
    strand_->post([caller] { caller.resume(); });
    return;
  }
  call->caller = caller;
  waiting_.push_back(call);
  if (within == kNoDeadline) return;
  call->deadline =
      clock_.schedule(saturating_sum(clock_.now(), within), strand_, [this, call] { finish(call, Outcome::Timeout); });
}

void Calls::finish(const std::shared_ptr<Call>& call, Outcome outcome, std::string reason) {
  if (call->ended) return;
  call->ended = true;
  call->outcome = outcome;
  call->reason = std::move(reason);
  if (!call->caller) return;
  clock_.cancel(call->deadline);
  std::erase(waiting_, call);
  std::exchange(call->caller, {}).resume();
}

void Calls::finish_all(Outcome outcome, const std::string& reason, std::uint64_t before) {
  for (const auto& call : std::vector(waiting_)) {
    if (call->since < before) finish(call, outcome, reason);
  }
}

}  // namespace fiona::detail
