#include "probe_cost.hpp"

#include <algorithm>
#include <mutex>
#include <vector>

#include "fiona/component.hpp"
#include "fiona/hull.hpp"
#include "fiona/testing/inline_executor.hpp"

namespace fiona::bench {
namespace {

class Shown final : public Component {
 public:
  using Component::Component;
  Probe<double> level{*this, "level"};
};

class NoEvents final : public HullEvents {
 public:
  void mode_changed(const std::string&, const std::string&, const std::string&) override {}
  void run_ended(const std::string&, int, const std::string&) override {}
  void logged(const std::string&, LogLevel, std::string_view) override {}
  void asked(const std::string&, std::uint64_t, const control::Request&) override {}
};

/// The median over rounds of what one of many takes.
template <class F>
Latency each(const Load& load, F once) {
  std::vector<double> rounds_ns;
  for (std::size_t round = 0; round < load.messages; ++round) {
    constexpr int kTimes = 1000;
    const auto begin = std::chrono::steady_clock::now();
    for (int i = 0; i < kTimes; ++i) once(i);
    rounds_ns.push_back(static_cast<double>((std::chrono::steady_clock::now() - begin).count()) / kTimes);
  }
  std::sort(rounds_ns.begin(), rounds_ns.end());
  return {rounds_ns[rounds_ns.size() / 2], 0};
}

}  // namespace

Latency set_of_probe(const Load& load) {
  testing::InlineExecutor executor;
  SystemClock clock;
  NoEvents events;
  Hull hull("shown", {executor, clock, events, {}});
  Shown* shown = nullptr;
  hull.create([&shown](Hull& owner) {
    auto made = std::make_unique<Shown>(owner);
    shown = made.get();
    return made;
  });
  const Latency cost = each(load, [shown](int i) { shown->level.set(i); });
  hull.shut_down(kDefaultDeadline);
  return cost;
}

namespace {

/// Strands that are watched write what they do.
class WatchedExecutor final : public Executor {
 public:
  explicit WatchedExecutor(std::shared_ptr<Liveness> liveness) : liveness_(std::move(liveness)) {}
  void submit(std::shared_ptr<Runnable> runnable) override { inline_.submit(std::move(runnable)); }
  void help() override { inline_.help(); }
  std::shared_ptr<Liveness> liveness() const override { return liveness_; }

 private:
  const std::shared_ptr<Liveness> liveness_;
  testing::InlineExecutor inline_;
};

Latency work_on(const Load& load, std::shared_ptr<Liveness> liveness) {
  WatchedExecutor executor(std::move(liveness));
  SystemClock clock;
  const auto strand = std::make_shared<Strand>("worker", executor, clock);
  volatile int sum = 0;
  const Latency cost = each(load, [&](int i) {
    strand->post([&sum, i] { sum = sum + i; });
    executor.help();
  });
  strand->close();
  return cost;
}

}  // namespace

Latency watched_work(const Load& load) { return work_on(load, std::make_shared<Liveness>()); }
Latency unwatched_work(const Load& load) { return work_on(load, nullptr); }

Latency locked_store(const Load& load) {
  struct Store {
    std::mutex mutex;
    volatile double value = 0;
    volatile std::int64_t set_ns = 0;
  } store;
  return each(load, [&store](int i) {
    const std::int64_t now_ns = std::chrono::steady_clock::now().time_since_epoch().count();
    const std::lock_guard lock(store.mutex);
    store.value = i;
    store.set_ns = now_ns;
  });
}

}  // namespace fiona::bench
