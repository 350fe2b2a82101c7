#include "remote_group.hpp"

#include <algorithm>
#include <iterator>
#include <utility>

#include "failure.hpp"
#include "fiona/error.hpp"

namespace fiona::host {
namespace {

/// More than a host gives a group of its own, for the way, but where it only asks for its status; and before one that
/// was silent is asked for that again.
constexpr std::chrono::seconds kWay{1};
constexpr std::chrono::seconds kPause{2};
/// What it leaves unanswered it may be doing still; and who compares what it has waits for it.
constexpr std::chrono::seconds kDoubt{1};
constexpr std::chrono::seconds kComparesEvery{5};

}  // namespace

void RemoteGroup::tell(wire::GroupRequest request) {
  if (end_.empty() && !peer_.tell(group_, request)) owe(std::move(request));
}

std::vector<wire::GroupRequest> RemoteGroup::take_owed() {
  auto owed = peer_.take_unanswered(group_);
  std::ranges::move(std::exchange(owed_, {}), std::back_inserter(owed));
  return owed;
}

std::optional<wire::GroupStatusReply> RemoteGroup::status(std::chrono::milliseconds patience) {
  const auto now = std::chrono::steady_clock::now();
  if (!alive() || (silent_since_ && now < ask_again_)) return std::nullopt;
  wire::GroupRequest request;
  request.mutable_status();
  try {
    const auto reply = ask(request, patience);
    if (reply.has_failure()) throw_failure(reply.failure());
    silent_since_.reset();
    return reply.status();
  } catch (const Error&) {  // its host will tell, or fall silent
    if (!silent_since_) silent_since_ = now;
    ask_again_ = std::chrono::steady_clock::now() + kPause;
    return std::nullopt;
  }
}

wire::GroupMessage RemoteGroup::perform(const wire::GroupRequest& request, std::chrono::milliseconds deadline) {
  wire::GroupMessage reply;
  try {
    reply = ask(request, deadline + kWay);
  } catch (const Error&) {
    doubt();
    throw;
  }
  if (reply.has_failure() && error_of(reply.failure()).code() == ErrorCode::Unreachable) doubt();
  return reply;
}

void RemoteGroup::is_compared() {
  compares_at_.reset();
  compared_ = std::chrono::steady_clock::now();
}

/// It may have done what it has not answered, or do it yet.
void RemoteGroup::doubt() {
  if (!compares_at_) compares_at_ = std::max(std::chrono::steady_clock::now() + kDoubt, compared_ + kComparesEvery);
}

wire::GroupMessage RemoteGroup::ask(const wire::GroupRequest& request, std::chrono::milliseconds patience) {
  if (meanwhile_) meanwhile_();
  if (end_.empty()) return peer_.request(group_, request, patience, meanwhile_);
  throw Error(ErrorCode::Unreachable,
              {.what = "group '" + name() + "' does not answer", .found = end_, .next = "ls hosts"});
}

}  // namespace fiona::host
