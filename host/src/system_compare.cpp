// Before a swap: what both say is compared while both run.
#include "fiona/error.hpp"
#include "fiona/service.hpp"
#include "system.hpp"

namespace fiona::host {
namespace {

bool pushes(const Model& model, const control::PortName& name) {
  const auto* service =
      Types::service(*model.instance(name.instance()).package->types, model.port(name, PROVIDES).service());
  return service && ServiceInfo(*service).is_push();
}

using Pair = std::pair<control::PortName, control::PortName>;

/// What is used of the old ones and can be compared, each with what would take its place. Throws where there is
/// nothing.
std::vector<Pair> comparable(const Model& model, const std::vector<control::Replace>& swaps) {
  std::vector<Pair> pairs;
  for (const auto& swap : swaps) {
    for (auto& pair : model.replaced_by(swap)) {
      if (pushes(model, pair.first)) pairs.push_back(std::move(pair));
    }
  }
  if (!pairs.empty()) return pairs;
  const std::string& old = swaps.front().old();
  throw Error(ErrorCode::Usage, {.what = "nothing that '" + old + "' is used for can be compared",
                                 .where = old,
                                 .expected = "a port that pushes, and a client of it",
                                 .next = "swap " + old + " for " + swaps.front().next() + ", without watch"});
}

control::Watch all_of(const control::PortName& name) {
  control::Watch watch;
  *watch.mutable_port() = name;
  return watch;
}

}  // namespace

std::pair<std::uint64_t, std::vector<std::uint64_t>> System::compare(const std::vector<control::Replace>& swaps,
                                                                     double within_ms, Waits::Answer answer) {
  const auto comparison = std::make_shared<Comparison>(types_);
  const std::vector<Pair> pairs = comparable(model_, swaps);
  std::vector<std::pair<std::uint64_t, std::uint64_t>> taps;
  for (const auto& [old, next] : pairs) {
    taps.emplace_back(new_tap(), new_tap());
    comparison->add(old, taps.back().first, next, taps.back().second);
  }
  const auto begin = [&] {
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      try {
        tap(taps[i].first, all_of(pairs[i].first), true);
      } catch (const Error&) {
        // There is nothing to compare with, and all the more reason to swap.
      }
      tap(taps[i].second, all_of(pairs[i].second), true);
    }
  };
  const auto end_of = [comparison](const wire::GroupMessage& event) {
    std::optional<control::Reply> reply;
    if (auto failure = comparison->note(event)) *reply.emplace().mutable_failure() = std::move(*failure);
    return reply;
  };
  control::Reply over;
  over.mutable_done()->set_watched_s(within_ms / 1e3);
  const auto ended = [comparison, answer = std::move(answer)](control::Reply reply) {
    if (reply.has_done()) {
      for (auto& one : comparison->agreements()) *reply.mutable_done()->add_agreements() = std::move(one);
      if (auto failure = comparison->objection()) *reply.mutable_failure() = std::move(*failure);
    }
    answer(std::move(reply));
  };
  const std::uint64_t number = next_work_++;
  try {
    waits_->work(kNobody, number, within_ms, begin, end_of, over, ended);
  } catch (...) {
    for (const std::uint64_t one : comparison->taps()) untap(one);
    throw;
  }
  return {number, comparison->taps()};
}

}  // namespace fiona::host
