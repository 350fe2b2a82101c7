// A component that may change the system.
#include <algorithm>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "components.hpp"

namespace fiona::test {

/// Changes the system as its parameters say, once for each change of `go`, and tells how that ended in a probe: the
/// number of the call, its outcome, and what came with it.
class Boss final : public Component {
 public:
  using Component::Component;

 private:
  void on_change() {
    if (params_->go() == std::exchange(gone_, params_->go())) return;
    if (params_->held()) {
      held_ = gone_;
    } else {
      hull().spawn(make(gone_), [] {});
    }
  }
  /// A task that waits holds the mode of its component.
  Async<> hold() {
    if (held_ > 0) co_await make(std::exchange(held_, 0));
  }
  void tell(std::uint64_t number, Outcome outcome, const std::string& text) {
    ended_.set(std::to_string(number) + " " + std::string(to_string(outcome)) + (text.empty() ? "" : " " + text));
  }
  template <class T>
  static std::string note_of(const Result<T>& result) {
    return result ? result->note() : result.reason();
  }
  Async<> make(std::uint64_t number) {
    const std::string call = params_->call();
    const std::string first = params_->first();
    const std::string second = params_->second();
    const auto within = from_ms(params_->deadline_ms());
    if (call == "list") {
      const auto system = co_await master_.system(within);
      std::string text = system ? "" : system.reason();
      if (system) {
        for (const auto& instance : system->instances()) {
          for (const auto& port : instance.ports()) {
            if (!port.peer().instance().empty())
              text += instance.name() + "." + port.name() + "<" + port.peer().instance() + " ";
          }
        }
      }
      tell(number, system.outcome(), text);
    } else if (call == "plan") {
      const auto planned = co_await master_.plan(Changes().wire(first, second), within);
      tell(number, planned.outcome(), planned ? std::to_string(planned->steps_size()) + " step" : planned.reason());
    } else if (call == "read") {
      const auto sample = co_await master_.read(first, within);
      tell(number, sample.outcome(), sample ? shown(*sample) : sample.reason());
    } else if (call == "watch") {
      WatchTerms terms;
      if (second.starts_with("above")) terms.when = when::above(std::stod(second.substr(5)));
      if (second.starts_with("every")) terms.every = static_cast<std::uint32_t>(std::stoul(second.substr(5)));
      if (second == "older") terms.when = when::older_than(100ms);
      auto watch = co_await master_.watch(first, terms, within);
      if (watch && second == "more") more_.push_back(std::move(watch.value()));
      if (watch && second != "more") watch_.emplace(std::move(watch.value()));
      tell(number, watch.outcome(), watch.reason());
    } else if (call == "fetch") {
      co_await fetch(number, within);
    } else if (call == "let_go") {
      watch_.reset();
      tell(number, Outcome::Ok, "");
    } else if (call == "cancelled") {
      cancel_calls(true);
      const auto done = co_await master_.wire(first, second, within);
      cancel_calls(false);
      tell(number, done.outcome(), note_of(done));
    } else if (call == "wire_by_default") {
      const auto done = co_await master_.wire(first, second);
      tell(number, done.outcome(), note_of(done));
    } else if (call == "many") {
      for (int i = 0; i < 80; ++i) hull().spawn(one_of_many(first, second), [] {});
    } else {
      Changes changes;
      if (call == "wire") changes.wire(first, second);
      if (call == "unwire") changes.unwire(first);
      if (call == "state") changes.state(first, second);
      if (call == "patient_state") changes.add(patient_state(first, second));
      if (call == "swap") changes.swap(first, second);
      if (call == "unload") changes.unload(first);
      if (call == "load") changes.load(first, second);
      if (call == "set") changes.set(first, "period_ms", 7).set(first, "valid", false);
      if (call == "batch") changes.wire(first, second).state(first.substr(0, first.find('.')), "nowhere");
      const auto done = co_await master_.make(std::move(changes), within);
      tell(number, done.outcome(), note_of(done));
    }
  }
  /// It has more time than the call that asks for it.
  static control::Change patient_state(const std::string& instance, const std::string& mode) {
    control::Change change;
    change.mutable_state()->set_instance(instance);
    change.mutable_state()->set_mode(mode);
    change.mutable_state()->set_within_ms(60'000);
    return change;
  }
  /// All that comes until nothing has come for so long: values, how many were missing, how it ended.
  Async<> fetch(std::uint64_t number, Duration within) {
    if (!watch_) co_return tell(number, Outcome::Rejected, "nothing is watched");
    std::string text;
    std::uint64_t values = 0, skipped = 0;
    while (true) {
      const auto seen = co_await watch_->next(within);
      if (!seen) {
        text = std::to_string(values) + " seen, " + std::to_string(skipped) + " missing: " + text + seen.reason();
        co_return tell(number, seen.outcome(), text);
      }
      text += shown(*seen) + " ";
      skipped += seen->skipped();
      ++values;
    }
  }
  static std::string shown(const control::Sample& sample) {
    if (const auto number = value_of<double>(sample))
      return std::to_string(*number).substr(0, std::to_string(*number).find('.'));
    if (const auto text = value_of<std::string>(sample)) return *text;
    return sample.type().empty() ? "nothing" : sample.type();
  }
  Async<> one_of_many(std::string first, std::string second) {
    const auto done = co_await master_.wire(first, second, 10s);
    ++(done ? made_ : refused_);
    if (made_ + refused_ == 80)
      tell(gone_, done.outcome(), std::to_string(made_) + " made, " + std::to_string(refused_) + " refused");
  }

  std::uint64_t gone_ = 0;
  std::uint64_t held_ = 0;
  int made_ = 0;
  int refused_ = 0;
  Params<BossParams> params_{*this, nullptr, &Boss::on_change};
  Master master_{*this};
  std::optional<Watch> watch_{};
  std::vector<Watch> more_{};
  Probe<std::string> ended_{*this, "ended"};
  Task hold_{*this, "hold", 5ms, &Boss::hold};
};

/// Asks for its own main mode whenever it is told of one, its start included. `ended` tells in which modes it has asked
/// and how each of the calls ended, in the order of their ends.
class Starter final : public Component {
 public:
  using Component::Component;
  void on_start() override { spawn(ask("init")); }
  void on_mode(std::string_view mode) override { spawn(ask(std::string(mode))); }

 private:
  Async<> ask(std::string mode) {
    asked_.set(++asks_);
    const auto done = co_await master_.state(name(), kModeActive, 60s);
    told_ += (told_.empty() ? "" : ", ") + mode + " " + std::string(to_string(done.outcome()));
    ended_.set(told_);
  }

  std::uint64_t asks_ = 0;
  std::string told_;
  Master master_{*this};
  Probe<std::uint64_t> asked_{*this, "asked"};
  Probe<std::string> ended_{*this, "ended"};
};

void add_master(Plugin& plugin) {
  plugin.add<Boss>("boss", "changes the system as its parameters say");
  plugin.add<Starter>("starter", "asks for its own main mode as soon as it is told of a mode");
}

}  // namespace fiona::test
