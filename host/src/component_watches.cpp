#include "component_watches.hpp"

#include <algorithm>
#include <vector>

#include "fiona/error.hpp"
#include "fiona/master.hpp"

namespace fiona::host {
namespace {

/// Values that are kept for one watch, and their bytes where there is more than one.
constexpr std::size_t kMostKept = 64;
constexpr std::size_t kMostKeptBytes = 4 * 1024 * 1024;

}  // namespace

void ComponentWatches::watch(const wire::Asked& asked) {
  const Id id{asked.instance(), asked.number()};
  end_left();
  if (watches_.contains(id)) {
    throw Error(ErrorCode::Usage, {.what = "a watch of this number is open already, and goes on",
                                   .where = id.first,
                                   .found = std::to_string(id.second),
                                   .next = "give each request a number of its own"});
  }
  const auto own = std::count_if(watches_.begin(), watches_.end(),
                                 [&](const auto& one) { return one.first.first == asked.instance(); });
  if (own >= static_cast<std::ptrdiff_t>(Master::kMaxOpen)) {
    throw Error(ErrorCode::Failed, {.what = "it watches " + std::to_string(own) + " things already",
                                    .where = asked.instance(),
                                    .expected = "at most " + std::to_string(Master::kMaxOpen),
                                    .next = "let go of one before the next"});
  }
  Watch& made = watches_[id];
  made.tap = system_.new_tap();
  made.life = system_.life_of(id.first);
  of_tap_[made.tap] = id;
  try {
    system_.tap(made.tap, asked.request().watch());
  } catch (...) {
    end(id);
    throw;
  }
}

std::optional<control::Reply> ComponentWatches::next(const wire::Asked& asked) {
  const control::Next& request = asked.request().next();
  end_left();
  const auto found = watches_.find({asked.instance(), request.watch()});
  if (found == watches_.end()) {
    throw Error(ErrorCode::NotFound, {.what = "this watch is over", .where = asked.instance(), .next = "watch again"});
  }
  Watch& watch = found->second;
  while (!watch.kept.empty() && watch.kept.front().number() <= request.after()) {
    watch.kept_bytes -= watch.kept.front().object().size();
    watch.kept.pop_front();
  }
  control::Reply reply;
  if (!watch.kept.empty()) {
    control::Sample& first = watch.kept.front();
    if (std::exchange(watch.given, 0) > request.after()) first.set_skipped(first.skipped() + watch.given_missing);
    watch.told = watch.kept.front().number();
    *reply.mutable_sample() = watch.kept.front();
    return reply;
  }
  if (!watch.over) {
    watch.waiting = asked;
    return std::nullopt;
  }
  *reply.mutable_failure() = *watch.over;
  return reply;
}

void ComponentWatches::on_event(const wire::GroupMessage& event) {
  if (event.has_tapped()) take(event.tapped());
  if (event.has_mode_changed() && event.mode_changed().mode() == kModeFailed) forget(event.mode_changed().instance());
  if (!event.has_tap_ended()) return;
  const auto found = of_tap_.find(event.tap_ended().tap());
  if (found == of_tap_.end()) return;
  const Id id = found->second;
  if (is_left(id)) return end(id);
  Watch& watch = watches_[id];
  watch.over = event.tap_ended().failure();
  if (!watch.waiting) return;
  control::Reply reply;
  *reply.mutable_failure() = *watch.over;
  system_.answer(*std::exchange(watch.waiting, std::nullopt), reply);
}

void ComponentWatches::take(const wire::Tapped& tapped) {
  const auto found = of_tap_.find(tapped.tap());
  if (found == of_tap_.end()) return;
  const Id id = found->second;
  if (is_left(id)) return end(id);
  Watch& watch = watches_[id];
  if (!watch.gaps.takes(tapped)) return;
  control::Sample sample = sample_of(tapped, system_.clock().start());
  sample.set_number(++watch.last);
  sample.set_skipped(watch.gaps.before(tapped));
  watch.kept_bytes += sample.object().size();
  watch.kept.push_back(std::move(sample));
  while (watch.kept.size() > kMostKept || (watch.kept.size() > 1 && watch.kept_bytes > kMostKeptBytes))
    drop_oldest(watch);
  if (!watch.waiting) return;
  control::Reply reply;
  watch.told = watch.kept.front().number();
  *reply.mutable_sample() = watch.kept.front();
  system_.answer(*std::exchange(watch.waiting, std::nullopt), reply);
}

/// It is missing before the one behind it, with what was missing before itself; one that has been told is not, if it
/// has arrived: who asked for it may have given up.
void ComponentWatches::drop_oldest(Watch& watch) {
  const control::Sample& oldest = watch.kept.front();
  const bool was_told = oldest.number() <= watch.told;
  const std::uint64_t missing = oldest.skipped() + 1;
  if (was_told) {
    watch.given = oldest.number();
    watch.given_missing = missing;
  }
  watch.kept_bytes -= oldest.object().size();
  watch.kept.pop_front();
  if (!was_told) watch.kept.front().set_skipped(watch.kept.front().skipped() + missing);
}

void ComponentWatches::end(const Id& id) {
  const auto found = watches_.find(id);
  if (found == watches_.end()) return;
  system_.untap(found->second.tap);
  of_tap_.erase(found->second.tap);
  watches_.erase(found);
}

/// By one of its name before it.
bool ComponentWatches::is_left(const Id& id) const {
  const auto found = watches_.find(id);
  return found != watches_.end() && found->second.life != system_.life_of(id.first);
}

void ComponentWatches::end_left() {
  std::vector<Id> left;
  for (const auto& [id, watch] : watches_) {
    if (is_left(id)) left.push_back(id);
  }
  for (const Id& id : left) end(id);
}

void ComponentWatches::forget(const std::string& instance) {
  while (true) {
    const auto found = watches_.lower_bound({instance, 0});
    if (found == watches_.end() || found->first.first != instance) return;
    end(Id(found->first));
  }
}

}  // namespace fiona::host
