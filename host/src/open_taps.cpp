#include "open_taps.hpp"

#include <utility>
#include <vector>

#include "failure.hpp"
#include "fiona/error.hpp"

namespace fiona::host {

void OpenTaps::open(Group& group, std::uint64_t tap, const control::Watch& watch, bool is_own) {
  wire::GroupRequest request;
  request.mutable_tap()->set_tap(tap);
  request.mutable_tap()->set_opening(++openings_);
  request.mutable_tap()->set_is_own(is_own);
  *request.mutable_tap()->mutable_watch() = watch;
  taps_.insert_or_assign(tap, Tap{group.name(), watch, is_own});
  try {
    group.request(std::move(request));
  } catch (...) {
    if (dynamic_cast<RemoteGroup*>(&group)) {
      close(tap);  // it may be made yet
    } else {
      taps_.erase(tap);
    }
    throw;
  }
}

void OpenTaps::close(std::uint64_t tap) {
  const auto found = taps_.find(tap);
  if (found == taps_.end()) return;
  Group* group = groups_.find(found->second.group);
  taps_.erase(found);
  const auto* remote = dynamic_cast<RemoteGroup*>(group);  // which is owed it while its host is silent
  if (!group || (!group->alive() && !(remote && remote->end().empty()))) return;
  wire::GroupRequest request;
  request.mutable_untap()->set_tap(tap);
  group->tell(std::move(request));
}

void OpenTaps::move(const std::string& instance, const std::string& from, const std::function<Group&()>& to) {
  std::vector<std::pair<std::uint64_t, Tap>> moved;
  for (const auto& [id, tap] : taps_) {
    if (tap.group == from && tap.watch.port().instance() == instance) moved.emplace_back(id, tap);
  }
  for (const auto& [id, tap] : moved) {
    close(id);
    try {
      open(to(), id, tap.watch, tap.is_own);
    } catch (const Error& error) {
      tell_ended(id, error);
    }
  }
}

void OpenTaps::lose(const std::string& group, const std::string& reason) {
  const Error gone(ErrorCode::Unreachable, {.what = reason, .next = "watch again once its group runs: ls"});
  for (const auto& [id, tap] : taps_) {
    if (tap.group == group) tell_ended(id, gone);
  }
  std::erase_if(taps_, [&group](const auto& tap) { return tap.second.group == group; });
}

void OpenTaps::tell_ended(std::uint64_t tap, const Error& why) const {
  wire::GroupMessage event;
  event.mutable_tap_ended()->set_tap(tap);
  *event.mutable_tap_ended()->mutable_failure() = failure_of(why);
  on_event_(event);
}

}  // namespace fiona::host
