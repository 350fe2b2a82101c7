// Probes of every kind.
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>

#include "components.hpp"

namespace fiona::test {

/// Shows what its parameters say, in probes of every kind; `silent` is never set.
class Gauge final : public Component {
 public:
  using Component::Component;
  void on_start() override {
    show();
    std::this_thread::sleep_for(from_ms(params_->start_ms()));
  }

 private:
  void on_change() {
    if (!params_->fail_with().empty()) return fail_.at(now());
    show();
    if (params_->go() == std::exchange(gone_, params_->go())) return;
    // Afterwards: who sets parameters waits for a piece of work of two seconds at most.
    hull().strand().post([this, last = params_->burst()] {
      for (std::uint32_t i = 1; i <= last; ++i) count_.set(i);
    });
  }
  void show() {
    level_.set(params_->level());
    word_.set(params_->word());
    open_.set(params_->level() > 0);
    Sample report;
    report.set_value(params_->level());
    report.set_payload(params_->word());
    report_.set(std::move(report));
  }
  void fail() { throw std::runtime_error(params_->fail_with()); }

  std::uint32_t gone_ = 0;
  Params<GaugeParams> params_{*this, nullptr, &Gauge::on_change};
  Probe<double> level_{*this, "level", {.unit = "m", .doc = "how high it stands"}};
  Probe<std::uint32_t> count_{*this, "count", {.doc = "of the last burst"}};
  Probe<bool> open_{*this, "open", {.doc = "the level is above zero"}};
  Probe<std::string> word_{*this, "word"};
  Probe<Sample> report_{*this, "report", {.doc = "level and word in one object"}};
  Probe<double> silent_{*this, "silent", {.unit = "s"}};
  Timer fail_{*this, &Gauge::fail};
};

void add_monitoring(Plugin& plugin) { plugin.add<Gauge>("gauge", "shows its parameters in probes"); }

}  // namespace fiona::test
