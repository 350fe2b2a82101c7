// Components that the conformance tests load as any system would: from a library, through the host.
#include <fiona/plugin.hpp>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdlib>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "fiona/test/test.fiona.hpp"

namespace fiona::test {

using namespace std::chrono_literals;

std::int64_t steady_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }

/// Puts numbered samples through every push pattern and the send pattern.
class Source final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) next_.at(now());
  }

 private:
  void put_next() {
    if (!params_->fail_with().empty()) throw std::runtime_error(params_->fail_with());
    if (params_->count() > 0 && number_ >= params_->count()) return;
    ++number_;
    newest_.put(sample());
    last_.put(sample());
    leased_.put(sample());
    bell_.put(sample());
    orders_.send(sample());
    next_.at(now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(params_->period_ms())));
  }
  void produce() { timed_.put(sample()); }
  void vouch() {
    if (params_->vouch()) leased_.still_valid();
  }
  std::optional<Crossing> ring(Threshold& threshold, const Sample& now) {
    threshold.set_seen(threshold.seen() + 1);
    if (threshold.throw_at() == now.number()) throw std::runtime_error("asked to throw");
    if (threshold.every() == 0 || threshold.seen() % threshold.every() != 0) return std::nullopt;
    Crossing crossing;
    crossing.set_number(now.number());
    crossing.set_seen(threshold.seen());
    crossing.set_payload(threshold.payload());
    return crossing;
  }
  Sample sample() const {
    Sample one;
    one.set_number(number_);
    one.set_sent_ns(steady_ns());
    one.mutable_payload()->resize(params_->payload());
    return one;
  }

  std::uint64_t number_ = 0;
  Params<SourceParams> params_{*this};
  Provides<SampleNewest> newest_{*this, "newest"};
  Provides<SampleLast> last_{*this, "last"};
  Provides<SampleTimed> timed_{*this, "timed", &Source::produce};
  Provides<SampleLeased> leased_{*this, "leased"};
  Provides<Bell> bell_{*this, "bell", &Source::ring};
  Task voucher_{*this, "voucher", 30ms, &Source::vouch};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
  Timer next_{*this, &Source::put_next};
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
    if (params_->work_ms() > 0) std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(params_->work_ms()));
    ++seen_;
    sum_ += static_cast<double>(sample->number());
    payload_ = sample->payload().size();
    report();
  }
  void on_order(const Sample& sample) {
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

/// Answers in the manner that the question asks for.
class Answerer final : public Component {
 public:
  using Component::Component;

 private:
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    if (question.manner() == "drop") return;
    if (question.manner() == "throw") throw std::runtime_error("asked to throw");
    if (question.manner() == "error") return reply.reject("asked to refuse");
    if (question.manner() == "never") return kept_.push_back(std::move(reply));
    Reply answer;
    answer.set_number(question.number());
    answer.set_payload(question.payload());
    if (question.manner() == "later") {
      if (waiting_.empty()) later_.at(now() + 50ms);
      waiting_.emplace_back(std::move(answer), std::move(reply));
      return;
    }
    reply.answer(std::move(answer));
  }
  void answer_waiting() {
    for (auto& [answer, reply] : std::exchange(waiting_, {})) reply.answer(std::move(answer));
  }

  std::vector<fiona::Reply<Reply>> kept_;
  std::vector<std::pair<Reply, fiona::Reply<Reply>>> waiting_;
  Provides<Echo> echo_{*this, "echo", &Answerer::on_question};
  Timer later_{*this, &Answerer::answer_waiting};
};

/// Asks once a period; reports the `number` of the question and the outcome in `value`, its reason in `payload`.
class Asker final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) next_.at(now());
  }

 private:
  void ask_next() {
    if (params_->count() > 0 && asked_ >= params_->count()) return;
    ++asked_;
    hull().spawn(ask(asked_), [] {});
    next_.at(now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(params_->period_ms())));
  }
  Async<> ask(std::uint64_t number) {
    Question question;
    question.set_number(number);
    question.set_manner(params_->manner());
    question.mutable_payload()->resize(params_->payload());
    const auto answer = co_await echo_.query(std::move(question), 500ms);
    Sample report;
    report.set_number(answer ? (*answer)->number() : number);
    report.set_value(static_cast<double>(answer.outcome()));
    report.set_payload(answer ? std::to_string((*answer)->payload().size()) : answer.reason());
    outcome_.put(std::move(report));
  }

  std::uint64_t asked_ = 0;
  Params<AskerParams> params_{*this};
  Requires<Echo> echo_{*this, "echo"};
  Provides<SampleLast> outcome_{*this, "outcome"};
  Timer next_{*this, &Asker::ask_next};
};

/// Makes the call that its parameters name, once for each change of `go`, and reports its outcome: `number` is `go`,
/// `value` the outcome, `payload` what came with it. Events of the port with a handler are reported on `rings`.
class Caller final : public Component {
 public:
  using Component::Component;

 private:
  void on_change() {
    cancel_all(params_->cancel());
    if (params_->go() == std::exchange(gone_, params_->go())) return;
    hull().spawn(make(gone_), [] {});
  }
  void cancel_all(const std::string& which) {
    samples_.cancel_calls(which == "port");
    echo_.cancel_calls(which == "port");
    bell_.cancel_calls(which == "port");
    cancel_calls(which == "instance");
    if (which != "pattern") return;
    for (const Pattern pattern : {PUSH_NEWEST, QUERY, EVENT}) cancel_calls(true, pattern);
  }
  void report(std::uint64_t number, Outcome outcome, std::string text) {
    Sample one;
    one.set_number(number);
    one.set_value(static_cast<double>(outcome));
    one.set_payload(std::move(text));
    outcome_.put(std::move(one));
  }
  Async<> make(std::uint64_t number) {
    const std::string call = params_->call();
    const auto within = std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(params_->deadline_ms()));
    Sample sample;
    sample.set_number(number);
    Question question;
    question.set_number(number);
    question.set_manner(params_->manner());
    if (call == "wait_update") {
      const auto next = co_await samples_.wait_update(within);
      report(number, next.outcome(), next ? std::to_string((*next)->number()) : next.reason());
    } else if (call == "latest") {
      const auto latest = samples_.latest();
      report(number, latest.outcome(), latest ? std::to_string((*latest)->number()) : latest.reason());
    } else if (call == "query" || call == "query_or_fail") {
      auto& port = call == "query" ? echo_ : failing_echo_;
      const auto answer = co_await port.query(std::move(question), within);
      report(number, answer.outcome(), answer ? std::to_string((*answer)->number()) : answer.reason());
    } else if (call == "request") {
      const auto id = echo_.request(std::move(question));
      if (id) request_ = *id;
      report(number, id.outcome(), id.reason());
    } else if (call == "receive") {
      const auto answer = co_await echo_.receive(request_, within);
      report(number, answer.outcome(), answer ? std::to_string((*answer)->number()) : answer.reason());
    } else if (call == "activate" || call == "activate_handled") {
      Threshold threshold;
      threshold.set_every(params_->every());
      threshold.set_throw_at(params_->throw_at());
      auto& port = call == "activate" ? bell_ : handled_bell_;
      const auto mode = params_->single() ? EventMode::Single : EventMode::Continuous;
      const auto id = co_await port.activate(mode, std::move(threshold), within);
      if (id) activation_ = *id;
      report(number, id.outcome(), id.reason());
    } else if (call == "event") {
      const auto event = co_await bell_.wait(activation_, within);
      report(number, event.outcome(),
             event ? std::to_string((*event)->number()) + " of " + std::to_string((*event)->seen()) : event.reason());
    } else if (call == "deactivate") {
      report(number, bell_.deactivate(activation_), "");
    } else if (call == "send") {
      report(number, orders_.send(std::move(sample)), "");
    } else if (call == "send_acknowledged") {
      const auto receipt = co_await orders_.send_acknowledged(std::move(sample), within);
      report(number, receipt.outcome(), receipt.reason());
    } else {
      report(number, Outcome::WrongId, "no such call: " + call);
    }
  }
  void on_ring(const Fired<Crossing>& crossing) {
    ++rings_;
    Sample one;
    one.set_number(rings_);
    one.set_value(static_cast<double>(crossing->number()));
    ring_report_.put(std::move(one));
  }

  std::uint64_t gone_ = 0;
  std::uint64_t rings_ = 0;
  QueryId request_{};
  ActivationId activation_{};
  Params<CallerParams> params_{*this, nullptr, &Caller::on_change};
  Requires<SampleNewest> samples_{*this, "samples", {.optional = true}};
  Requires<Echo> echo_{*this, "echo", {.optional = true}};
  Requires<Echo> failing_echo_{*this, "failing_echo", {.optional = true, .at_rewire = AtRewire::Fail}};
  Requires<Bell> bell_{*this, "bell", {.optional = true}};
  Requires<Bell> handled_bell_{*this, "handled_bell", &Caller::on_ring, {.optional = true}};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
  Provides<SampleNewest> outcome_{*this, "outcome"};
  Provides<SampleNewest> ring_report_{*this, "rings"};
};

/// Has three main modes: `drive` and `park` share the activity `look`; `rest` has none.
class Mover final : public Component {
 public:
  using Component::Component;

 private:
  void look() { looks_.put(numbered(++looked_)); }
  Async<> steer() {
    if (params_->work_ms() > 0) {
      const auto most = std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(params_->work_ms()));
      const auto order = co_await orders_in_.wait_update(most);
      outcome_.put(numbered(static_cast<std::uint64_t>(order.outcome())));
    }
    steers_.put(numbered(++steered_));
  }
  TurnResult turn(const TurnRequest& request) {
    if (request.manner() == "error") throw Error(ErrorCode::Failed, "the wheel is stuck");
    if (request.manner() == "throw") throw std::runtime_error("the wheel came off");
    heading_ += request.degrees();
    TurnResult result;
    result.set_heading(heading_);
    return result;
  }
  Async<TurnResult> turn_later(const TurnRequest& request) {
    co_await orders_in_.wait_update(50ms);
    co_return turn(request);
  }
  static Sample numbered(std::uint64_t number) {
    Sample one;
    one.set_number(number);
    return one;
  }

  std::uint64_t looked_ = 0;
  std::uint64_t steered_ = 0;
  int heading_ = 0;
  Modes modes_{*this, {{"drive", {"look", "steer"}}, {"park", {"look"}}, {"rest", {}}}};
  Params<MoverParams> params_{*this};
  Provides<SampleNewest> looks_{*this, "looks"};
  Provides<SampleNewest> steers_{*this, "steers"};
  Provides<SampleNewest> outcome_{*this, "outcome"};
  Requires<SampleNewest> orders_in_{*this, "orders", {.optional = true, .activity = "steer"}};
  Trigger<TurnRequest, TurnResult> turn_{*this, "turn", &Mover::turn, {.doc = "turns on the spot", .activity = "steer"}};
  Trigger<TurnRequest, TurnResult> turn_later_{*this, "turn_later", &Mover::turn_later, {.activity = "steer"}};
  Task look_{*this, "look", 5ms, &Mover::look, "look"};
  Task steer_{*this, "steer", 5ms, &Mover::steer, "steer"};
};

/// Ticks and answers, so that whoever hears it can tell which ticker it was and whether anything is missing.
class Ticker final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) next_.at(now());
  }

 private:
  void tick() {
    Sample sample;
    sample.set_number(++ticked_);
    sample.set_value(static_cast<double>(params_->source()));
    samples_.put(std::move(sample));
    next_.at(now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(params_->period_ms())));
  }
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    ++answered_;
    Reply answer;
    answer.set_number(question.number());
    reply.answer(std::move(answer));
  }
  TickerReport report(const Question&) {
    TickerReport report;
    report.set_ticked(ticked_);
    report.set_answered(answered_);
    return report;
  }

  std::uint64_t ticked_ = 0;
  std::uint64_t answered_ = 0;
  Params<TickerParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
  Provides<Echo> echo_{*this, "echo", &Ticker::on_question};
  Trigger<Question, TickerReport> report_{*this, "report", &Ticker::report};
  Timer next_{*this, &Ticker::tick};
};

/// Hears and asks whoever it is wired to, and can say exactly what came of it.
class Witness final : public Component {
 public:
  using Component::Component;

 private:
  void on_change() {
    if (params_->asks()) next_.at(now());
  }
  void on_sample(const Sample& sample) {
    const std::int64_t heard_ns = steady_ns();
    if (heard_ns_ > 0) testimony_.set_longest_gap_ms(std::max(testimony_.longest_gap_ms(), static_cast<double>(heard_ns - heard_ns_) / 1e6));
    heard_ns_ = heard_ns;
    const auto source = static_cast<std::uint64_t>(sample.value());
    std::uint64_t& newest = newest_[source];
    if (sample.number() <= newest) testimony_.set_backward(testimony_.backward() + 1);
    newest = std::max(newest, sample.number());
    Run* run = testimony_.runs_size() == 0 ? nullptr : testimony_.mutable_runs(testimony_.runs_size() - 1);
    if (!run || run->source() != source || sample.number() != run->first() + run->count()) {
      run = testimony_.add_runs();
      run->set_source(source);
      run->set_first(sample.number());
    }
    run->set_count(run->count() + 1);
  }
  void ask_next() {
    if (!params_->asks()) return;
    hull().spawn(ask(), [] {});
    next_.at(now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(params_->period_ms())));
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
  Testimony testify(const Question&) { return testimony_; }

  Testimony testimony_;
  std::int64_t heard_ns_ = 0;
  std::map<std::uint64_t, std::uint64_t> newest_;
  Params<WitnessParams> params_{*this, nullptr, &Witness::on_change};
  Requires<SampleNewest> samples_{*this, "samples", &Witness::on_sample};
  Requires<Echo> echo_{*this, "echo"};
  Trigger<Question, Testimony> testify_{*this, "testify", &Witness::testify};
  Timer next_{*this, &Witness::ask_next};
};

/// One of several that say where something is, and answer.
class Beacon final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) next_.at(now());
  }

 private:
  void put_next() {
    next_.at(now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(params_->period_ms())));
    if (params_->silent()) return;
    if (params_->once() && number_ > 0) {
      fixes_.still_valid();
      last_.still_valid();
      return;
    }
    Fix fix;
    fix.set_source(hull().name());
    fix.set_number(++number_);
    fix.set_is_valid(params_->valid());
    fixes_.put(fix);
    last_.put(fix);
  }
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    Reply answer;
    answer.set_number(question.number());
    answer.set_payload(hull().name());
    if (question.manner() != "later") return reply.answer(std::move(answer));
    if (waiting_.empty()) later_.at(now() + 20ms);
    waiting_.emplace_back(std::move(answer), std::move(reply));
  }
  void answer_waiting() {
    for (auto& [answer, reply] : std::exchange(waiting_, {})) reply.answer(std::move(answer));
  }
  void on_order(const Sample& order) { ordered_.set(order.number()); }

  std::uint64_t number_ = 0;
  std::vector<std::pair<Reply, fiona::Reply<Reply>>> waiting_;
  Params<BeaconParams> params_{*this};
  Provides<Fixes> fixes_{*this, "fixes"};
  Provides<LastFixes> last_{*this, "last"};
  Provides<Echo> echo_{*this, "echo", &Beacon::on_question};
  Provides<Order> orders_{*this, "orders", &Beacon::on_order};
  Probe<std::uint64_t> ordered_{*this, "ordered", {.doc = "number of the last order"}};
  Timer next_{*this, &Beacon::put_next};
  Timer later_{*this, &Beacon::answer_waiting};
};

/// Uses several beacons, and tells in probes what it heard from whom.
class Navigator final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) next_.at(now());
  }

 private:
  /// "a 1-57, b 12-40, a 80!-": with ! those that were not valid.
  struct Heard {
    std::string text;
    std::string source;
    std::uint64_t last = 0;
    bool valid = true;

    const std::string& add(const Fix& fix, std::uint64_t step) {
      const bool goes_on = fix.source() == source && fix.number() == last + step && fix.is_valid() == valid && !text.empty();
      if (!goes_on && !text.empty()) text += std::to_string(last) + ", ";
      if (!goes_on) text += fix.source() + " " + std::to_string(fix.number()) + (fix.is_valid() ? "-" : "!-");
      source = fix.source();
      last = fix.number();
      valid = fix.is_valid();
      whole = text + std::to_string(last);
      return whole;
    }
    std::string whole;
  };
  void on_fix(const Fix& fix) { heard_probe_.set(heard_.add(fix, params_->step())); }
  void on_last(const Fix& fix) { last_probe_.set(last_heard_.add(fix, params_->step())); }
  void turn() {
    const auto latest = latest_.latest();
    latest_probe_.set(latest ? "ok " + (*latest)->source() : std::string(to_string(latest.outcome())));
    if (!waits_) {
      waits_ = true;
      hull().spawn(wait(), [] {});
    }
    const double asks_ms = params_->asks_ms();
    if (asks_ms > 0) hull().spawn(ask(), [] {});
    next_.at(now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(asks_ms > 0 ? asks_ms : 5)));
  }
  Async<> wait() {
    const auto next = co_await latest_.wait_update(10s);
    waits_ = false;
    if (!next && next.outcome() == Outcome::Disconnected) waited_probe_.set(next.reason());
  }
  Async<> ask() {
    Question question;
    question.set_number(++asked_);
    question.set_manner(params_->manner());
    ++open_;
    orders_.send(order());
    const auto answer = co_await echo_.query(std::move(question), 2s);
    --open_;
    ++outcomes_[answer ? (*answer)->payload() : std::string(to_string(answer.outcome()))];
    std::string text;
    std::uint64_t ended = 0;
    for (const auto& [outcome, count] : outcomes_) {
      text += outcome + "=" + std::to_string(count) + " ";
      ended += count;
    }
    if (ended + open_ != asked_) text += "WRONG";
    answers_probe_.set(text);
    by_probe_.set(answer ? (*answer)->payload() : "");
  }
  Sample order() const {
    Sample one;
    one.set_number(asked_);
    return one;
  }

  Heard heard_;
  Heard last_heard_;
  bool waits_ = false;
  std::uint64_t asked_ = 0;
  std::uint64_t open_ = 0;
  std::map<std::string, std::uint64_t> outcomes_;
  Params<NavigatorParams> params_{*this};
  Requires<Fixes> fixes_{*this, "fixes", &Navigator::on_fix, {.optional = true}};
  Requires<LastFixes> last_{*this, "last", &Navigator::on_last, {.optional = true}};
  Requires<Fixes> latest_{*this, "latest", {.optional = true}};
  Requires<Echo> echo_{*this, "echo", {.optional = true}};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
  Probe<std::string> heard_probe_{*this, "heard"};
  Probe<std::string> last_probe_{*this, "last_heard"};
  Probe<std::string> latest_probe_{*this, "latest_is"};
  Probe<std::string> waited_probe_{*this, "wait_ended", {.doc = "why a wait ended disconnected"}};
  Probe<std::string> answers_probe_{*this, "answers"};
  Probe<std::string> by_probe_{*this, "answered_by"};
  Timer next_{*this, &Navigator::turn};
};

/// Shows what its parameters say, in probes of every kind; `silent` is never set.
class Gauge final : public Component {
 public:
  using Component::Component;
  void on_start() override { show(); }

 private:
  void on_change() {
    if (!params_->fail_with().empty()) return fail_.at(now());
    show();
    if (params_->go() == std::exchange(gone_, params_->go())) return;
    for (std::uint32_t i = 1; i <= params_->burst(); ++i) count_.set(i);
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

/// Puts samples at a pace, stamped at the last moment: the sending half of a latency benchmark.
class Pacer final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) next_.at(now());
  }

 private:
  void put_next() {
    if (++number_ < params_->count()) {
      next_.at(now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(params_->period_ms())));
    }
    auto sample = samples_.make();
    sample->set_number(number_);
    sample->mutable_payload()->assign(params_->payload(), 'x');
    const std::int64_t begun_ns = steady_ns();
    sample->set_sent_ns(begun_ns);
    samples_.put(std::move(sample));
    longest_ms_ = std::max(longest_ms_, static_cast<double>(steady_ns() - begun_ns) / 1e6);
    longest_put_.set(longest_ms_);
  }
  std::uint64_t number_ = 0;
  double longest_ms_ = 0;
  Params<SourceParams> params_{*this};
  Provides<SampleNewest> samples_{*this, "samples"};
  Probe<double> longest_put_{*this, "longest_put", {.unit = "ms"}};
  Timer next_{*this, &Pacer::put_next};
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

/// Uses every pattern at random, on a grid of milliseconds so that much falls into the same instant. What it does next
/// depends on everything that it has received and on the order of that, and it tells in all that it sends: one message
/// out of order anywhere changes all that comes after.
class Mingler final : public Component {
 public:
  using Component::Component;
  void on_start() override { mix(params_->seed()); }
  void on_mode(std::string_view mode) override {
    if (mode != kModeActive) return;
    last_.put(sample());
    next_.at(now() + 1ms);
  }

 private:
  /// The finaliser of splitmix64 over all so far.
  void mix(std::uint64_t value) {
    state_ += value + 0x9e3779b97f4a7c15;
    state_ = (state_ ^ state_ >> 30) * 0xbf58476d1ce4e5b9;
    state_ = (state_ ^ state_ >> 27) * 0x94d049bb133111eb;
    state_ ^= state_ >> 31;
  }
  std::uint64_t below(std::uint64_t bound) {
    mix(bound);
    return state_ % bound;
  }
  Sample sample() {
    Sample one;
    one.set_number(state_);
    one.set_payload(std::string(below(40), 'x'));
    return one;
  }
  Question question() {
    Question one;
    one.set_number(state_);
    return one;
  }
  void note(std::uint64_t port, const Sample& sample) { mix(port << 56 ^ sample.number()); }

  void step() {
    next_.at(now() + std::chrono::milliseconds(1 + below(4)));
    switch (below(10)) {
      case 0: newest_.put(sample()); break;
      case 1: last_.put(sample()); break;
      case 2: leased_.put(sample()); break;
      case 3: bell_.put(sample()); break;
      case 4: static_cast<void>(orders_out_.send(sample())); break;
      case 5: hull().spawn(send(), [] {}); break;
      case 6:
      case 7: hull().spawn(ask(), [] {}); break;
      case 8: hull().spawn(await_bell(), [] {}); break;
      case 9: hull().spawn(await_sample(), [] {}); break;
    }
  }
  Async<> send() {
    const auto receipt = co_await orders_out_.send_acknowledged(sample(), 3ms);
    mix(100 + static_cast<std::uint64_t>(receipt.outcome()));
  }
  /// The deadline may fall into the very instant of the answer.
  Async<> ask() {
    const auto answer = co_await echo_out_.query(question(), std::chrono::milliseconds(2 + below(2)));
    mix(answer ? (*answer)->number() : 200 + static_cast<std::uint64_t>(answer.outcome()));
  }
  Async<> await_bell() {
    Threshold threshold;
    threshold.set_every(1 + static_cast<std::uint32_t>(below(3)));
    const bool single = below(2) == 0;
    const auto mode = single ? EventMode::Single : EventMode::Continuous;
    const auto id = co_await bell_out_.activate(mode, std::move(threshold), 5ms);
    mix(300 + static_cast<std::uint64_t>(id.outcome()));
    if (!id) co_return;
    const auto event = co_await bell_out_.wait(*id, 20ms);
    mix(event ? (*event)->number() : 400 + static_cast<std::uint64_t>(event.outcome()));
    if (!single) mix(500 + static_cast<std::uint64_t>(bell_out_.deactivate(*id)));
  }
  Async<> await_sample() {
    const auto next = co_await waited_.wait_update(4ms);
    mix(next ? (*next)->number() : 600 + static_cast<std::uint64_t>(next.outcome()));
  }

  void on_each(const Sample& sample) { note(1, sample); }
  void on_newest(const Sample& sample) { note(2, sample); }
  void on_last(const Sample& sample) {
    note(3, sample);
    if (below(3) == 0) newest_.put(this->sample());  // in the same instant
  }
  void on_leased(const Received<Sample>& sample) { note(4, *sample); }
  void on_timed(const Sample& sample) { note(5, sample); }
  void on_order(const Sample& sample) {
    note(6, sample);
    if (below(4) == 0) static_cast<void>(orders_out_.send(this->sample()));
  }
  void produce() {
    if (leased_in_.connection() == Connection::Lost) mix(7);
    timed_.put(sample());
  }
  std::optional<Crossing> ring(Threshold& threshold, const Sample& now) {
    threshold.set_seen(threshold.seen() + 1);
    if (threshold.seen() % threshold.every() != 0) return std::nullopt;
    Crossing crossing;
    crossing.set_number(now.number());
    crossing.set_seen(threshold.seen());
    return crossing;
  }
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    mix(question.number());
    Reply answer;
    answer.set_number(state_);
    switch (below(4)) {
      case 0: return reply.answer(std::move(answer));
      case 1: return reply.reject("not now");
      case 2: return never_.push_back(std::move(reply));
      case 3: waiting_.emplace_back(std::move(answer), std::move(reply)); break;
    }
    later_.at(now() + 2ms);
  }
  void answer_waiting() {
    for (auto& [answer, reply] : std::exchange(waiting_, {})) {
      if (reply.abandoned()) mix(8);
      reply.answer(std::move(answer));
    }
    if (never_.size() > 20) never_.clear();
  }

  std::uint64_t state_ = 0;
  Params<MinglerParams> params_{*this};
  std::vector<fiona::Reply<Reply>> never_;
  std::vector<std::pair<Reply, fiona::Reply<Reply>>> waiting_;
  Provides<SampleNewest> newest_{*this, "newest"};
  Provides<SampleLast> last_{*this, "last"};
  Provides<SampleLeased> leased_{*this, "leased"};
  Provides<SampleTimed> timed_{*this, "timed", &Mingler::produce};
  Provides<Bell> bell_{*this, "bell", &Mingler::ring};
  Provides<Echo> echo_{*this, "echo", &Mingler::on_question};
  Provides<Order> orders_{*this, "orders", &Mingler::on_order};
  Requires<SampleNewest> each_{*this, "each_in", &Mingler::on_each, {.optional = true}};
  Requires<SampleNewest> newest_in_{*this, "newest_in", &Mingler::on_newest, {.optional = true, .delivery = Delivery::Newest}};
  Requires<SampleNewest> waited_{*this, "waited_in", {.optional = true}};
  Requires<SampleLast> last_in_{*this, "last_in", &Mingler::on_last, {.optional = true}};
  Requires<SampleLeased> leased_in_{*this, "leased_in", &Mingler::on_leased, {.optional = true}};
  Requires<SampleTimed> timed_in_{*this, "timed_in", &Mingler::on_timed, {.optional = true}};
  Requires<Bell> bell_out_{*this, "bell_in", {.optional = true}};
  Requires<Echo> echo_out_{*this, "echo_in", {.optional = true}};
  Requires<Order> orders_out_{*this, "orders_in", {.optional = true}};
  Timer next_{*this, &Mingler::step};
  Timer later_{*this, &Mingler::answer_waiting};
};

/// Stays in a handler, or ends its process.
class Hog final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) begin_.at(now() + from_ms(params_->from_ms()));
  }

 private:
  static Duration from_ms(double ms) {
    return std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(ms));
  }
  void stay() {
    if (params_->die()) std::_Exit(3);
    std::this_thread::sleep_for(from_ms(params_->for_ms()));
  }
  Params<HogParams> params_{*this};
  Timer begin_{*this, &Hog::stay};
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

/// Asks `count` questions, each when the one before is answered; reports the median round trip in `value`.
class Prober final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) hull().spawn(ask(), [] {});
  }

 private:
  Async<> ask() {
    std::vector<std::int64_t> times_ns;
    for (std::uint64_t i = 0; i < params_->count(); ++i) {
      const auto begun_ns = steady_ns();
      Question question;
      question.mutable_payload()->assign(params_->payload(), 'x');
      const auto answer = co_await echo_.query(std::move(question), 5s);
      if (!answer) throw std::runtime_error("a question was not answered");
      times_ns.push_back(steady_ns() - begun_ns);
    }
    std::sort(times_ns.begin(), times_ns.end());
    Sample report;
    report.set_number(times_ns.size());
    report.set_value(static_cast<double>(times_ns[times_ns.size() / 2]));
    report_.put(std::move(report));
  }

  Params<FloodParams> params_{*this};
  Requires<Echo> echo_{*this, "echo"};
  Provides<SampleLast> report_{*this, "report"};
};

}  // namespace fiona::test

FIONA_PLUGIN(plugin) {
  plugin.add<fiona::test::Source>("source", "puts numbered samples");
  plugin.add<fiona::test::Sink>("sink", "counts what it receives");
  plugin.add<fiona::test::Answerer>("answerer", "answers in the manner asked for");
  plugin.add<fiona::test::Asker>("asker", "asks, and reports the outcome");
  plugin.add<fiona::test::Caller>("caller", "makes one call at a time, and reports the outcome");
  plugin.add<fiona::test::Mover>("mover", "has modes that share activities");
  plugin.add<fiona::test::Mingler>("mingler", "uses every pattern at random");
  plugin.add<fiona::test::Hog>("hog", "stays in a handler, or ends its process");
  plugin.add<fiona::test::Ticker>("ticker", "ticks and answers");
  plugin.add<fiona::test::Witness>("witness", "tells exactly what it heard and was answered");
  plugin.add<fiona::test::Beacon>("beacon", "says where something is, if it knows");
  plugin.add<fiona::test::Navigator>("navigator", "tells what it heard from which beacon");
  plugin.add<fiona::test::Gauge>("gauge", "shows its parameters in probes");
  plugin.add<fiona::test::Pacer>("pacer", "puts stamped samples at a pace");
  plugin.add<fiona::test::Stopwatch>("stopwatch", "measures how long samples took");
  plugin.add<fiona::test::Flooder>("flooder", "puts as fast as its counters follow");
  plugin.add<fiona::test::Counter>("counter", "counts what a flooder puts");
  plugin.add<fiona::test::Prober>("prober", "measures how long an answer takes");
}
