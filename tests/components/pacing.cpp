// Who puts at the pace of its consumers, and a consumer that takes its time.
#include <string>

#include "components.hpp"

namespace fiona::test {

/// Puts `count` samples one behind the other, each when there is room for it; in `outcome` tells after each how many it
/// has put, and as the value how the last call ended. It gives up after one that was not put, until it is made active
/// again.
class Pourer final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) begin_.at(now() + 1ms);  // in virtual time: once the lines that wire it have run
  }

 private:
  void begin() {
    hull().spawn(pour(), [] {});
  }
  void on_change() {
    samples_.cancel_calls(params_->cancel() == "port");
    cancel_calls(params_->cancel() == "instance");
    cancel_calls(params_->cancel() == "pattern", PUSH_NEWEST);
  }
  Async<> pour() {
    while (number_ < params_->count()) {
      auto sample = samples_.make();
      sample->set_number(number_ + 1);
      sample->mutable_payload()->assign(params_->payload(), 'x');
      waits_.set(1);
      const Outcome outcome = co_await samples_.put(std::move(sample), from_ms(params_->deadline_ms()));
      waits_.set(0);
      if (outcome == Outcome::Ok) ++number_;
      Sample report;
      report.set_number(number_);
      report.set_value(static_cast<double>(outcome));
      outcome_.put(std::move(report));
      if (outcome != Outcome::Ok) co_return;
    }
  }

  std::uint64_t number_ = 0;
  Params<PourerParams> params_{*this, nullptr, &Pourer::on_change};
  Provides<SampleNewest> samples_{*this, "samples"};
  Provides<SampleLast> outcome_{*this, "outcome"};
  Provides<SampleNewest> never_{*this, "never"};
  Probe<std::uint64_t> waits_{*this, "waits", {.doc = "how many of its puts have not ended"}};
  Timer begin_{*this, &Pourer::begin};
};

/// Takes `sip_ms` of its clock for each sample, without keeping a thread: the port `never` is to be wired to one that
/// is silent. Tells in `report` how many it has had, and as the value how many of them came out of order.
class Sipper final : public Component {
 public:
  using Component::Component;

 private:
  Async<> on_sample(const Sample& sample) {
    if (sample.number() != ++seen_) ++wrong_;
    if (params_->sip_ms() > 0) static_cast<void>(co_await never_.wait_update(from_ms(params_->sip_ms())));
    Sample report;
    report.set_number(seen_);
    report.set_value(wrong_);
    report_.put(std::move(report));
  }

  std::uint64_t seen_ = 0;
  double wrong_ = 0;
  Params<SipperParams> params_{*this};
  Requires<SampleNewest> samples_{*this, "samples", &Sipper::on_sample};
  Requires<SampleNewest> never_{*this, "never", {.optional = true}};
  Provides<SampleLast> report_{*this, "report"};
};

void add_pacing(Plugin& plugin) {
  plugin.add<Pourer>("pourer", "puts at the pace of its consumers");
  plugin.add<Sipper>("sipper", "takes its time for each sample");
}

}  // namespace fiona::test
