// A component that may change the system.
#include <algorithm>
#include <string>
#include <utility>

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
    } else if (call == "many") {
      for (int i = 0; i < 80; ++i) hull().spawn(one_of_many(first, second), [] {});
    } else {
      Changes changes;
      if (call == "wire") changes.wire(first, second);
      if (call == "unwire") changes.unwire(first);
      if (call == "state") changes.state(first, second);
      if (call == "swap") changes.swap(first, second);
      if (call == "unload") changes.unload(first);
      if (call == "load") changes.load(first, second);
      if (call == "set") changes.set(first, "period_ms", 7).set(first, "valid", false);
      if (call == "batch") changes.wire(first, second).state(first.substr(0, first.find('.')), "nowhere");
      const auto done = co_await master_.make(std::move(changes), within);
      tell(number, done.outcome(), note_of(done));
    }
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
  Probe<std::string> ended_{*this, "ended"};
  Task hold_{*this, "hold", 5ms, &Boss::hold};
};

void add_master(Plugin& plugin) { plugin.add<Boss>("boss", "changes the system as its parameters say"); }

}  // namespace fiona::test
