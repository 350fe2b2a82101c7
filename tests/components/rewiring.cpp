// What is rewired under load, and knows exactly what it has heard.
#include <algorithm>
#include <cstddef>
#include <map>
#include <utility>

#include "components.hpp"

namespace fiona::test {

/// Ticks and answers, so that whoever hears it can tell which ticker it was and whether anything is missing.
class Ticker final : public Paced {
 public:
  using Paced::Paced;

 private:
  void tick() override {
    if (has_ended_) return;
    Sample sample;
    sample.set_number(++ticked_);
    sample.set_value(static_cast<double>(params_->source()));
    sample.set_sent_ns(born_ns_);
    const std::size_t before = samples_.subscribers();
    samples_.put(std::move(sample));
    const std::size_t after = samples_.subscribers();
    sent_least_ += std::min(before, after);
    sent_most_ += std::max(before, after);
    again_after(params_->period_ms());
  }
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    ++answered_;
    Reply answer;
    answer.set_number(question.number());
    reply.answer(std::move(answer));
  }
  /// In the manner 'last' it ticks no more.
  TickerReport report(const Question& question) {
    if (question.manner() == "last") has_ended_ = true;
    TickerReport report;
    report.set_ticked(ticked_);
    report.set_answered(answered_);
    report.set_sent_least(sent_least_);
    report.set_sent_most(sent_most_);
    return report;
  }

  const std::int64_t born_ns_ = steady_ns();  ///< one that is started again counts from 1 again
  std::uint64_t ticked_ = 0;
  std::uint64_t answered_ = 0;
  std::uint64_t sent_least_ = 0, sent_most_ = 0;
  bool has_ended_ = false;
  Params<TickerParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
  Provides<Echo> echo_{*this, "echo", &Ticker::on_question};
  Trigger<Question, TickerReport> report_{*this, "report", &Ticker::report};
};

/// Hears and asks whoever it is wired to, and can say exactly what came of it.
class Witness final : public Paced {
 public:
  using Paced::Paced;

 private:
  static constexpr int kMostRuns = 100'000;

  void on_change() {
    if (params_->asks()) again_after(0);
  }
  void on_sample(const Sample& sample) {
    const std::int64_t heard_ns = steady_ns();
    if (heard_ns_ > 0)
      testimony_.set_longest_gap_ms(
          std::max(testimony_.longest_gap_ms(), static_cast<double>(heard_ns - heard_ns_) / 1e6));
    heard_ns_ = heard_ns;
    const auto source = static_cast<std::uint64_t>(sample.value());
    std::uint64_t& newest = newest_[{source, sample.sent_ns()}];
    if (sample.number() <= newest) testimony_.set_backward(testimony_.backward() + 1);
    newest = std::max(newest, sample.number());
    Run* run = testimony_.runs_size() == 0 ? nullptr : testimony_.mutable_runs(testimony_.runs_size() - 1);
    if (!run || run->source() != source || sample.number() != run->first() + run->count()) {
      if (testimony_.runs_size() >= kMostRuns) testimony_.clear_runs();
      run = testimony_.add_runs();
      run->set_source(source);
      run->set_first(sample.number());
    }
    run->set_count(run->count() + 1);
  }
  void tick() override {
    if (!params_->asks()) return;
    hull().spawn(ask(), [] {});
    again_after(params_->period_ms());
  }
  Async<> ask() {
    const std::uint64_t number = testimony_.asked() + 1;
    testimony_.set_asked(number);
    testimony_.set_open(testimony_.open() + 1);
    Question question;
    question.set_number(number);
    const auto answer = co_await echo_.query(std::move(question), 2s);
    const int outcome = static_cast<int>(answer.outcome());
    while (testimony_.outcomes_size() <= outcome) testimony_.add_outcomes(0);
    testimony_.set_outcomes(outcome, testimony_.outcomes(outcome) + 1);
    if (answer && (*answer)->number() != number) testimony_.set_wrong(testimony_.wrong() + 1);
    testimony_.set_open(testimony_.open() - 1);
  }
  /// In the manner 'gap' it forgets the longest gap so far.
  Testimony testify(const Question& question) {
    const Testimony now = testimony_;
    if (question.manner() == "gap") testimony_.set_longest_gap_ms(0);
    return now;
  }

  Testimony testimony_;
  std::int64_t heard_ns_ = 0;
  std::map<std::pair<std::uint64_t, std::int64_t>, std::uint64_t> newest_;  ///< by ticker, and when it was made
  Params<WitnessParams> params_{*this, nullptr, &Witness::on_change};
  Requires<SampleNewest> samples_{*this, "samples", &Witness::on_sample};
  Requires<Echo> echo_{*this, "echo"};
  Trigger<Question, Testimony> testify_{*this, "testify", &Witness::testify};
};

void add_rewiring(Plugin& plugin) {
  plugin.add<Ticker>("ticker", "ticks and answers");
  plugin.add<Witness>("witness", "tells exactly what it heard and was answered");
}

}  // namespace fiona::test
