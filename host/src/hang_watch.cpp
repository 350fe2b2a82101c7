#include "hang_watch.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "fiona/hull.hpp"
#include "os/limits.hpp"

namespace fiona::host {
namespace {

constexpr std::string_view kLifeCycleCalls[] = {kItsStart, kItsModeChange, kItsStop};
constexpr std::string_view kOtherCalls[] = {kItsParameters, kItsDestructor, kItsLibrary, kItsConstructor};

std::uint32_t mark_of(std::uint64_t work) { return static_cast<std::uint32_t>(work); }

std::string name_in(const Liveness::Slot& slot) {
  return {slot.name, std::find(std::begin(slot.name), std::end(slot.name), '\0')};
}

/// What another process has written may be anything.
std::string inert_name(std::string name) {
  std::replace_if(
      name.begin(), name.end(), [](char c) { return c <= ' ' || c > '~'; }, '?');
  return name;
}

}  // namespace

std::string Hang::what() const {
  const double seconds = std::chrono::duration<double>(time).count();
  if (instance.empty()) return fmt::format("stood still for {:.1f} s", seconds);
  return fmt::format("stuck{} for {:.1f} s", in.empty() ? "" : " in " + in, seconds);
}

std::string Hang::text() const { return instance.empty() ? "it " + what() : "'" + instance + "' was " + what(); }

HangWatch::milliseconds HangWatch::passed(Time now) {
  const auto since = std::chrono::duration_cast<milliseconds>(now - std::exchange(looked_, now));
  return std::min(since, kMostBetween);
}

/// For how long a thread of the process has waited for a CPU since it was called last, while something was stuck. Of
/// several the one that has waited longest: they do so at the same time, and all together for longer than there was.
HangWatch::milliseconds HangWatch::waited_for_cpu(pid_t process) {
  const auto now = os::times_waiting_for_cpu(process);
  const auto before = std::exchange(delays_, now).value_or(now);
  std::chrono::nanoseconds longest(0);
  for (const auto& [thread, waited] : now) {
    const auto known = before.find(thread);
    longest = std::max(longest, known == before.end() ? waited : waited - known->second);
  }
  return std::chrono::duration_cast<milliseconds>(longest);
}

HangWatch::milliseconds HangWatch::patience_with(const Liveness::Slot& slot, std::uint64_t work) const {
  const auto is = [&](std::string_view text) { return Liveness::mark(text) == mark_of(work); };
  if (std::any_of(std::begin(kLifeCycleCalls), std::end(kLifeCycleCalls), is)) return kLifeCycle;
  if (is(kItsLibrary) || is(kItsConstructor)) return kOpening;
  return parts_(name_in(slot)).value_or(Part()).work;
}

bool HangWatch::hangs(Seen& seen, const Liveness::Slot& slot, milliseconds step, milliseconds waited) const {
  seen.in_all += step;
  seen.stood += step - std::min(step, waited);
  if (seen.told || seen.in_all < kWork) return false;
  const milliseconds patience = patience_with(slot, seen.work);
  return (seen.stood >= patience || seen.in_all >= std::max(patience, kStarved));
}

std::vector<Hang> HangWatch::look(Time now, pid_t process, bool stopped) {
  if (now - looked_ < std::chrono::milliseconds(20)) return {};
  const milliseconds step = passed(now);
  std::vector<Hang> hangs_now;
  stopped_ = stopped ? stopped_ + step : milliseconds(0);
  if (stopped_ >= kStopped) hangs_now.push_back({"", "", stopped_});
  seen_.resize(std::min<std::size_t>(page_.used.load(std::memory_order_relaxed), Liveness::kSlots));
  std::optional<milliseconds> waited;
  for (std::size_t i = 0; i < seen_.size(); ++i) {
    Seen& seen = seen_[i];
    const std::uint64_t work = page_.slots[i].work.load(std::memory_order_acquire);
    if (work == 0 || work != seen.work) {
      seen = {work};
      continue;
    }
    if (!waited) waited = waited_for_cpu(process);
    if (!hangs(seen, page_.slots[i], step, *waited)) continue;
    seen.told = true;
    hangs_now.push_back(hang_of(page_.slots[i], seen));
  }
  if (!waited) delays_.reset();
  return hangs_now;
}

Hang HangWatch::hang_of(const Liveness::Slot& slot, const Seen& seen) const {
  const std::string name = name_in(slot);
  const auto known = parts_(name);
  Hang hang{known ? name : inert_name(name), "", seen.in_all, &slot};
  std::vector<std::string> texts = known.value_or(Part()).texts;
  texts.insert(texts.end(), std::begin(kLifeCycleCalls), std::end(kLifeCycleCalls));
  texts.insert(texts.end(), std::begin(kOtherCalls), std::end(kOtherCalls));
  for (const auto& text : texts) {
    if (Liveness::mark(text) == mark_of(seen.work)) hang.in = text;
  }
  return hang;
}

}  // namespace fiona::host
