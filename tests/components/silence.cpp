// What is looked at while it is killed, stopped and cut off, and who looks.
#include <algorithm>
#include <string>
#include <utility>

#include "components.hpp"

namespace fiona::test {

/// Puts in every manner, and answers: what a lookout looks at.
class Station final : public Paced {
 public:
  using Paced::Paced;

 private:
  void tick() override {
    ++number_;
    samples_.put(sample(params_->payload()));
    if (number_ == 1) last_.put(sample(0));  // no more: who joins later has what is kept, or nothing
    again_after(params_->period_ms());
  }
  void produce() {
    const TimePoint origin = now();  // no later than what the sample says of when it was sent
    timed_.put(sample(0), origin);
  }
  Sample sample(std::size_t payload) const {
    Sample one;
    one.set_number(number_);
    one.set_sent_ns(steady_ns());
    one.mutable_payload()->resize(payload);
    return one;
  }
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    Reply answer;
    answer.set_number(question.number());
    reply.answer(std::move(answer));
  }

  std::uint64_t number_ = 0;
  Params<SourceParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
  Provides<SampleLast> last_{*this, "last"};
  Provides<SampleTimed> timed_{*this, "timed", &Station::produce};
  Provides<Echo> echo_{*this, "echo", &Station::on_question};
};

/// Looks at a station all the time, asks it, and can say how old what it was given was, and when it was told of a loss.
class Lookout final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) ask_.at(now());
  }

 private:
  static constexpr Duration kTwoPeriods = 40ms;  ///< of SampleTimed
  static double ms_since(std::int64_t ns) { return static_cast<double>(steady_ns() - ns) / 1e6; }

  void look() {
    const std::int64_t asked_ns = steady_ns();  // before: then a value cannot have become too old since it was given
    const auto latest = timed_.latest();
    const bool sees = static_cast<bool>(latest);
    if (sees) {
      const double age_ms = static_cast<double>(asked_ns - (*latest)->sent_ns()) / 1e6;
      seen_.set_oldest_shown_ms(std::max(seen_.oldest_shown_ms(), age_ms));
    }
    if (sees && !seen_.sees()) seen_.set_seen_ns(asked_ns);
    if (!sees && seen_.sees()) seen_.set_blank_ns(asked_ns);
    seen_.set_sees(sees);
    const bool lost = latest.outcome() == Outcome::Disconnected;
    if (lost && !std::exchange(lost_, lost)) seen_.set_lost_ns(asked_ns);
    lost_ = lost;
  }
  void on_sample(const Sample& sample) {
    seen_.set_oldest_heard_ms(std::max(seen_.oldest_heard_ms(), ms_since(sample.sent_ns())));
    seen_.set_heard(seen_.heard() + 1);
  }
  void on_last(const Sample&) {
    if (seen_.last_ns() == 0) seen_.set_last_ns(steady_ns());
  }
  void ask_next() {
    hull().spawn(ask(), [] {});
    ask_.at(now() + from_ms(params_->asks_ms()));
  }
  Async<> ask() {
    seen_.set_asked(seen_.asked() + 1);
    ++open_;
    const double deadline_ms = params_->deadline_ms();
    const std::int64_t begun_ns = steady_ns();
    const auto answer = co_await echo_.query(Question(), from_ms(deadline_ms));
    seen_.set_longest_over_ms(std::max(seen_.longest_over_ms(), ms_since(begun_ns) - deadline_ms));
    const int outcome = static_cast<int>(answer.outcome());
    while (seen_.outcomes_size() <= outcome) seen_.add_outcomes(0);
    seen_.set_outcomes(outcome, seen_.outcomes(outcome) + 1);
    --open_;
  }
  Sighting testify(const Question& question) {
    Sighting said = seen_;
    said.set_open(open_);
    if (question.manner() == "forget") {
      seen_.Clear();
      seen_.set_sees(said.sees());
      seen_.set_asked(open_);  // their outcomes are still to come
    }
    return said;
  }

  Sighting seen_;
  bool lost_ = false;
  std::uint64_t open_ = 0;
  Params<LookoutParams> params_{*this};
  Requires<SampleTimed> timed_{*this, "timed", {.max_age = kTwoPeriods}};
  Requires<SampleNewest> samples_{*this, "samples", &Lookout::on_sample, {.max_age = 500ms}};
  Requires<SampleLast> last_{*this, "last", &Lookout::on_last, {.optional = true}};
  Requires<Echo> echo_{*this, "echo"};
  Trigger<Question, Sighting> testify_{*this, "testify", &Lookout::testify};
  Task look_{*this, "look", 2ms, &Lookout::look};
  Timer ask_{*this, &Lookout::ask_next};
};

void add_silence(Plugin& plugin) {
  plugin.add<Station>("station", "puts in every manner, and answers");
  plugin.add<Lookout>("lookout", "tells how old what it was given was, and when it was told of a loss");
}

}  // namespace fiona::test
