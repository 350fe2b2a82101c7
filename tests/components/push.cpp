// Push and send: who puts, who receives, and who measures how fast that goes.
#include <unistd.h>

#include <algorithm>
#include <array>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "components.hpp"

namespace fiona::test {

/// Puts numbered samples through every push pattern and the send pattern.
class Source final : public Paced {
 public:
  using Paced::Paced;

 private:
  void tick() override {
    if (!params_->fail_with().empty()) throw std::runtime_error(params_->fail_with());
    if (params_->hang_ms() > 0)
      std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(params_->hang_ms()));
    if (params_->count() > 0 && number_ >= params_->count()) return;
    ++number_;
    const auto one = std::make_shared<const Sample>(sample());  // they may be large
    newest_.put(one);
    last_.put(one);
    leased_.put(one);
    bell_.put(*one);
    if (orders_.connection() != Connection::Unwired) orders_.send(*one);
    again_after(params_->period_ms());
  }
  void produce() { timed_.put(sample(timed_.subscribers() > 0)); }
  void vouch() {
    if (params_->vouch()) leased_.still_valid();
    subscribers_.set(newest_.subscribers());
  }
  std::optional<Crossing> ring(Threshold& threshold, const Sample& now) {
    tested_.set(++tests_);
    threshold.set_seen(threshold.seen() + 1);
    if (threshold.throw_at() == now.number()) throw std::runtime_error("asked to throw");
    if (threshold.every() == 0 || threshold.seen() % threshold.every() != 0) return std::nullopt;
    Crossing crossing;
    crossing.set_number(now.number());
    crossing.set_seen(threshold.seen());
    crossing.set_payload(threshold.payload());
    return crossing;
  }
  Sample sample(bool with_payload = true) const {
    Sample one;
    one.set_number(number_);
    one.set_sent_ns(steady_ns());
    if (with_payload) one.mutable_payload()->resize(params_->payload());
    one.set_value(params_->value());
    return one;
  }

  std::uint64_t number_ = 0;
  std::uint64_t tests_ = 0;
  Params<SourceParams> params_{*this};
  Probe<std::uint64_t> tested_{*this, "tested", {.doc = "how often a state was put to an activation"}};
  Probe<std::uint64_t> subscribers_{*this, "subscribers", {.doc = "of its newest, as its own port counts them"}};
  Provides<SampleNewest> newest_{*this, "newest"};
  Provides<SampleLast> last_{*this, "last"};
  Provides<SampleTimed> timed_{*this, "timed", &Source::produce};
  Provides<SampleLeased> leased_{*this, "leased"};
  Provides<Bell> bell_{*this, "bell", &Source::ring};
  Task voucher_{*this, "voucher", 30ms, &Source::vouch};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
};

/// Receives, and tells in a push service of its own what it has seen, so that a test can watch it from anywhere:
/// `number` counts the messages, `value` is the sum of their numbers, `payload` the size of the newest one's payload.
class Sink final : public Component {
 public:
  using Component::Component;
  void on_start() override {
    if (!params_->leave_child() || ::fork() != 0) return;
    ::sleep(1);
    ::_exit(0);
  }

 private:
  void on_sample(const Received<Sample>& sample) {
    if (params_->work_ms() > 0)
      std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(params_->work_ms()));
    ++seen_;
    sum_ += static_cast<double>(sample->number());
    payload_ = sample->payload().size();
    report();
  }
  void on_order(const Sample& sample) {
    if (params_->order_ms() > 0)
      std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(params_->order_ms()));
    ++seen_;
    sum_ += static_cast<double>(sample.number());
    report();
  }
  void poll() {
    const auto latest = latest_.latest();
    if (!latest) return;
    Sample report;
    report.set_number((*latest)->number());
    report.set_value(latest->stale ? 1 : 0);
    latest_report_.put(std::move(report));
  }
  void report() {
    Sample one;
    one.set_number(seen_);
    one.set_value(sum_);
    one.set_payload(std::to_string(payload_));
    report_.put(std::move(one));
  }

  std::uint64_t seen_ = 0;
  double sum_ = 0;
  std::size_t payload_ = 0;
  Params<SinkParams> params_{*this};
  Requires<SampleNewest> each_{*this, "each", &Sink::on_sample, {.optional = true}};
  Requires<SampleNewest> newest_{*this, "newest", &Sink::on_sample, {.optional = true, .delivery = Delivery::Newest}};
  Requires<SampleTimed> timed_{*this, "timed", &Sink::on_sample, {.optional = true}};
  Requires<SampleLast> last_{*this, "last", &Sink::on_sample, {.optional = true}};
  Requires<SampleLeased> leased_{*this, "leased", &Sink::on_sample, {.optional = true}};
  Requires<SampleNewest> latest_{*this, "latest", {.optional = true}};
  Provides<Order> orders_{*this, "orders", &Sink::on_order};
  Provides<SampleLast> report_{*this, "report"};
  Provides<SampleNewest> latest_report_{*this, "latest_report"};
  Task poller_{*this, "poller", 10ms, &Sink::poll};
};

/// Puts samples at a pace, stamped at the last moment: the sending half of a latency benchmark.
class Pacer final : public Paced {
 public:
  using Paced::Paced;

 private:
  void tick() override {
    if (++number_ < params_->count()) {
      again_after(params_->period_ms());
    }
    auto sample = samples_.make();
    sample->set_number(number_);
    sample->mutable_payload()->assign(params_->payload(), 'x');
    sample->set_sent_ns(steady_ns());
    samples_.put(std::move(sample));
  }
  std::uint64_t number_ = 0;
  Params<SourceParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
};

/// The receiving half: after `count` messages reports the median latency in `value`, the 99th percentile in `sent_ns`,
/// and in `number` when the last one came.
class Stopwatch final : public Component {
 public:
  using Component::Component;

 private:
  void on_sample(const Sample& sample) {
    const std::int64_t came_ns = steady_ns();
    latencies_ns_.push_back(came_ns - sample.sent_ns());
    if (latencies_ns_.size() < params_->count()) return;
    std::sort(latencies_ns_.begin(), latencies_ns_.end());
    Sample report;
    report.set_number(static_cast<std::uint64_t>(came_ns));
    report.set_value(static_cast<double>(latencies_ns_[latencies_ns_.size() / 2]));
    report.set_sent_ns(latencies_ns_[latencies_ns_.size() * 99 / 100]);
    latencies_ns_.clear();
    report_.put(std::move(report));
  }
  std::vector<std::int64_t> latencies_ns_;
  Params<SourceParams> params_{*this};
  Requires<SampleNewest> samples_{*this, "samples", &Stopwatch::on_sample};
  Provides<SampleLast> report_{*this, "report"};
};

/// Puts as fast as its counters follow: at most `window` messages ahead of the slowest of them, so that none is lost.
class Flooder final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) put_more();
  }

 private:
  void put_more() {
    const auto slowest = *std::min_element(seen_.begin(), seen_.begin() + params_->counters());
    while (number_ < params_->count() && number_ < slowest + params_->window()) {
      auto sample = samples_.make();
      sample->set_number(++number_);
      sample->mutable_payload()->assign(params_->payload(), 'x');
      samples_.put(std::move(sample));
    }
  }
  void on_progress(const Sample& progress) {
    seen_.at(static_cast<std::size_t>(progress.value())) = progress.number();
    put_more();
  }

  std::uint64_t number_ = 0;
  std::array<std::uint64_t, 8> seen_{};
  Params<FloodParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
  Requires<SampleNewest> progress0_{*this, "progress0", &Flooder::on_progress, {.optional = true}};
  Requires<SampleNewest> progress1_{*this, "progress1", &Flooder::on_progress, {.optional = true}};
  Requires<SampleNewest> progress2_{*this, "progress2", &Flooder::on_progress, {.optional = true}};
  Requires<SampleNewest> progress3_{*this, "progress3", &Flooder::on_progress, {.optional = true}};
  Requires<SampleNewest> progress4_{*this, "progress4", &Flooder::on_progress, {.optional = true}};
  Requires<SampleNewest> progress5_{*this, "progress5", &Flooder::on_progress, {.optional = true}};
  Requires<SampleNewest> progress6_{*this, "progress6", &Flooder::on_progress, {.optional = true}};
  Requires<SampleNewest> progress7_{*this, "progress7", &Flooder::on_progress, {.optional = true}};
};

/// Counts for a flooder; at the last message reports in `value` the nanoseconds that each took.
class Counter final : public Component {
 public:
  using Component::Component;

 private:
  void on_sample(const Sample&) {
    if (++number_ == 1) begun_ns_ = steady_ns();
    if (number_ % std::max<std::uint64_t>(1, params_->window() / 4) == 0) {
      Sample progress;
      progress.set_number(number_);
      progress.set_value(params_->index());
      progress_.put(std::move(progress));
    }
    if (number_ != params_->count()) return;
    Sample report;
    report.set_number(number_);
    report.set_value(static_cast<double>(steady_ns() - begun_ns_) / static_cast<double>(number_ - 1));
    report_.put(std::move(report));
  }

  std::uint64_t number_ = 0;
  std::int64_t begun_ns_ = 0;
  Params<FloodParams> params_{*this};
  Requires<SampleNewest> samples_{*this, "samples", &Counter::on_sample};
  Provides<SampleNewest> progress_{*this, "progress"};
  Provides<SampleLast> report_{*this, "report"};
};

void add_push(Plugin& plugin) {
  plugin.add<Source>("source", "puts numbered samples");
  plugin.add<Sink>("sink", "counts what it receives");
  plugin.add<Pacer>("pacer", "puts stamped samples at a pace");
  plugin.add<Stopwatch>("stopwatch", "measures how long samples took");
  plugin.add<Flooder>("flooder", "puts as fast as its counters follow");
  plugin.add<Counter>("counter", "counts what a flooder puts");
}

}  // namespace fiona::test
