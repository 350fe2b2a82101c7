// Every call that waits.
#include <initializer_list>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>

#include "components.hpp"

namespace fiona::test {

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
    for (Port* port : std::initializer_list<Port*>{&samples_, &echo_, &bell_, &orders_})
      port->cancel_calls(which == "port" || which == port->name());
    cancel_calls(which == "instance");
    for (const Pattern pattern : {PUSH_NEWEST, QUERY, EVENT, SEND})
      cancel_calls(which == "pattern" || which == Pattern_Name(pattern), pattern);
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
    const auto within = from_ms(params_->deadline_ms());
    Sample sample;
    sample.set_number(number);
    Question question;
    question.set_number(number);
    question.set_manner(params_->manner());
    sample.mutable_payload()->resize(params_->payload());
    if (call == "wait_update") {
      const auto next = co_await samples_.wait_update(within);
      report(number, next.outcome(), next ? std::to_string((*next)->number()) : next.reason());
    } else if (call == "latest") {
      const auto latest = samples_.latest();
      report(number, latest.outcome(), latest ? aged(*latest) : latest.reason());
    } else if (call == "latest_leased") {
      const auto latest = leased_.latest();
      report(number, latest.outcome(), latest ? aged(*latest) : latest.reason());
    } else if (call == "latest_last") {
      const auto latest = last_.latest();
      report(number, latest.outcome(), latest ? aged(*latest) : latest.reason());
    } else if (call == "ask_without_end") {
      // Each call fails at once: the port has no wire.
      std::uint64_t asked = 0;
      for (; params_->call() == call; ++asked) static_cast<void>(co_await failing_echo_.query(question, within));
      report(number, Outcome::Ok, std::to_string(asked));
    } else if (call == "throw") {
      throw std::runtime_error("asked to throw");
    } else if (call == "discard") {
      report(number, echo_.discard(request_), "");
    } else if (call == "send_burst") {
      std::map<Outcome, std::uint64_t> ends;
      for (std::uint64_t i = 0; i < params_->every(); ++i) ++ends[orders_.send(sample)];
      report(number, Outcome::Ok, text_of(ends));
    } else if (call == "send_many") {
      many_.clear();
      for (std::uint64_t i = 0; i < params_->every(); ++i) hull().spawn(send_one(number), [] {});
    } else if (call == "lookup") {
      const auto answer = co_await lookup_.query(std::move(question), within);
      report(number, answer.outcome(), answer ? std::to_string((*answer)->number()) : answer.reason());
    } else if (call == "query_by_default") {
      const auto answer = co_await echo_.query(std::move(question));
      report(number, answer.outcome(), answer ? std::to_string((*answer)->number()) : answer.reason());
    } else if (call == "query" || call == "query_or_fail") {
      auto& port = call == "query" ? echo_ : failing_echo_;
      const auto answer = co_await port.query(std::move(question), within);
      report(number, answer.outcome(), answer ? std::to_string((*answer)->number()) : answer.reason());
    } else if (call == "query_twice") {
      // What hears of the end of the first uses the component's ports at once.
      const auto first = co_await echo_.query(question, within);
      const auto second = co_await echo_.query(std::move(question), within);
      report(number, second.outcome(), std::string(to_string(first.outcome())));
    } else if (call == "request") {
      const auto id = echo_.request(std::move(question), within);
      if (id) request_ = *id;
      report(number, id.outcome(), id.reason());
    } else if (call == "receive") {
      const auto answer = co_await echo_.receive(request_, within);
      report(number, answer.outcome(), answer ? std::to_string((*answer)->number()) : answer.reason());
    } else if (call == "receive_by_default") {
      const auto answer = co_await echo_.receive(request_);
      report(number, answer.outcome(), answer.reason());
    } else if (call == "event_by_default") {
      const auto event = co_await bell_.wait(activation_);
      report(number, event.outcome(), event.reason());
    } else if (call == "activate" || call == "activate_handled") {
      Threshold threshold;
      threshold.set_every(params_->every());
      threshold.set_throw_at(params_->throw_at());
      threshold.mutable_payload()->resize(params_->payload());
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
  /// How many ended in which way: "ok=180 disconnected=20".
  static std::string text_of(const std::map<Outcome, std::uint64_t>& ends) {
    std::string text;
    for (const auto& [outcome, count] : ends)
      text += std::string(to_string(outcome)) + "=" + std::to_string(count) + " ";
    return text;
  }
  /// One of many; the last tells how they ended.
  Async<> send_one(std::uint64_t number) {
    const auto receipt = co_await orders_.send_acknowledged({}, 5s);
    ++many_[receipt.outcome()];
    std::uint64_t ended = 0;
    for (const auto& [outcome, count] : many_) ended += count;
    if (ended == params_->every()) report(number, Outcome::Ok, text_of(many_));
  }
  /// "5", "5 stale", and how old it is in ms.
  std::string aged(const Received<Sample>& sample) const {
    const auto age = std::chrono::duration_cast<std::chrono::milliseconds>(now() - sample.origin);
    return std::to_string(sample->number()) + (sample.stale ? " stale " : " ") + std::to_string(age.count());
  }
  void on_ring(const Fired<Crossing>& crossing) {
    std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(params_->ring_ms()));
    ++rings_;
    Sample one;
    one.set_number(rings_);
    one.set_value(static_cast<double>(crossing->number()));
    one.set_payload(std::to_string(crossing->payload().size()));
    ring_report_.put(std::move(one));
  }

  std::uint64_t gone_ = 0;
  std::uint64_t rings_ = 0;
  std::map<Outcome, std::uint64_t> many_;
  QueryId request_{};
  ActivationId activation_{};
  Params<CallerParams> params_{*this, nullptr, &Caller::on_change};
  Requires<SampleNewest> samples_{*this, "samples", {.optional = true}};
  Requires<Echo> echo_{*this, "echo", {.optional = true}};
  Requires<Echo> failing_echo_{*this, "failing_echo", {.optional = true, .at_rewire = AtRewire::Fail}};
  Requires<SampleLeased> leased_{*this, "leased", {.optional = true}};
  Requires<SampleLast> last_{*this, "last", {.optional = true}};
  Requires<Lookup> lookup_{*this, "lookup", {.optional = true, .at_rewire = AtRewire::Redirect}};
  Requires<Bell> bell_{*this, "bell", {.optional = true}};
  Requires<Bell> handled_bell_{*this, "handled_bell", &Caller::on_ring, {.optional = true}};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
  Provides<SampleNewest> outcome_{*this, "outcome"};
  Provides<SampleNewest> ring_report_{*this, "rings"};
};

/// Makes the calls that its parameters name as a caller does, from a thread of its own.
class ThreadCaller final : public Component {
 public:
  using Component::Component;

 private:
  /// Whether there is a call to make. Rarely: what its process waits for a processor excuses what hangs there.
  static constexpr auto kLooks = 20ms;

  void on_change() {
    samples_.cancel_calls(params_->cancel() == "port");
    echo_.cancel_calls(params_->cancel() == "port");
    bell_.cancel_calls(params_->cancel() == "port");
    cancel_calls(params_->cancel() == "instance");
    for (const Pattern pattern : {PUSH_NEWEST, QUERY, EVENT}) cancel_calls(params_->cancel() == "pattern", pattern);
  }
  void work(const OwnThread& own) {
    const auto params = params_.snapshot();
    if (params->go() == std::exchange(gone_, params->go())) return void(own.wait_for(kLooks));
    const auto outcome = outcome_of(own, *params);
    if (!outcome) return;
    own.post([this, number = gone_, outcome = *outcome] {
      Sample one;
      one.set_number(number);
      one.set_value(static_cast<double>(outcome));
      outcome_.put(std::move(one));
    });
  }
  /// None: the task is to stop.
  std::optional<Outcome> outcome_of(const OwnThread& own, const CallerParams& params) {
    const std::string& call = params.call();
    const auto within = from_ms(params.deadline_ms());
    if (call == "wait_update") return end_of(own, [this, within] { return samples_.wait_update(within); });
    if (call == "send_acknowledged")
      return end_of(own, [this, within] { return orders_.send_acknowledged(Sample(), within); });
    if (call == "query") {
      Question question;
      question.set_manner(params.manner());
      return end_of(own, [this, question, within] { return echo_.query(question, within); });
    }
    if (call == "event") return end_of(own, [this, id = activation_, within] { return bell_.wait(id, within); });
    if (call != "activate") return Outcome::WrongId;
    Threshold threshold;
    threshold.set_every(params.every());
    const auto id = own.await([this, threshold, within, number = gone_] {
      begin(number);
      return bell_.activate(EventMode::Continuous, threshold, within);
    });
    if (!id) return std::nullopt;
    if (*id) activation_ = **id;
    return id->outcome();
  }
  template <class F>
  std::optional<Outcome> end_of(const OwnThread& own, F call) {
    const auto result = own.await([this, call, number = gone_] {
      begin(number);
      return call();
    });
    return result ? std::optional(result->outcome()) : std::nullopt;
  }
  /// On the strand. Told by the next piece of work there: when this one ends, the call waits.
  void begin(std::uint64_t number) {
    begins_ = number;
    waits_.at(now());
  }
  void tell_begun() { begun_.set(begins_); }

  std::uint64_t gone_ = 0;
  std::uint64_t begins_ = 0;
  ActivationId activation_{};
  Params<CallerParams> params_{*this, nullptr, &ThreadCaller::on_change};
  Requires<SampleNewest> samples_{*this, "samples", {.optional = true}};
  Requires<Echo> echo_{*this, "echo", {.optional = true}};
  Requires<Bell> bell_{*this, "bell", {.optional = true}};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
  Provides<SampleNewest> outcome_{*this, "outcome"};
  Probe<std::uint64_t> begun_{*this, "begun", {.doc = "the newest call that waits, or has ended"}};
  Timer waits_{*this, &ThreadCaller::tell_begun};
  Task work_{*this, "work", free_running, &ThreadCaller::work};
};

/// Waits for calls as long as it lives, and uses each of its ports once more when it is told that it ends. The log says
/// what came of that.
class Leaver final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode != kModeActive) return;
    spawn(ask());
    spawn(wait());
    spawn(listen());
  }
  void on_stop() override {
    std::string told = "at its end:";
    const auto tell = [&told](std::string_view call, Outcome outcome) {
      told += " " + std::string(call) + "=" + std::string(to_string(outcome));
    };
    const auto end = [this](auto call) { spawn(ended(std::move(call))); };
    cancel_calls();
    cancel_calls(false);
    echo_.cancel_calls();
    echo_.cancel_calls(false);
    report_.put(Sample());
    state_.put(Sample());
    timed_.stop();
    timed_.start();
    later_.at(now());
    tell("send", orders_.send(Sample()));
    tell("request", echo_.request(Question()).outcome());
    tell("latest", samples_.latest().outcome());
    tell("discard", echo_.discard(QueryId{1}));
    tell("deactivate", bell_.deactivate(ActivationId{1'000'000}));
    end(echo_.query(Question()));
    end(samples_.wait_update(1s));
    end(orders_.send_acknowledged(Sample()));
    end(bell_.activate(EventMode::Single, Threshold()));
    stops_.set(params_->every());
    log(LogLevel::Info, told);
  }

 private:
  template <class T>
  static Async<> ended(Async<T> call) {
    static_cast<void>(co_await call);
  }
  Async<> ask() {
    Question question;
    question.set_manner("never");
    static_cast<void>(co_await echo_.query(std::move(question), 60s));
  }
  Async<> wait() { static_cast<void>(co_await samples_.wait_update(60s)); }
  Async<> listen() {
    Threshold never;
    const auto id = co_await bell_.activate(EventMode::Continuous, std::move(never));
    if (id) static_cast<void>(co_await bell_.wait(*id, 60s));
  }
  void produce() {}
  std::optional<Crossing> test(Threshold&, const Sample&) { return Crossing(); }
  void too_late() { orders_.send(Sample()); }

  Params<CallerParams> params_{*this};
  Requires<SampleNewest> samples_{*this, "samples"};
  Requires<Echo> echo_{*this, "echo"};
  Requires<Bell> bell_{*this, "bell"};
  Requires<Order> orders_{*this, "orders"};
  Provides<SampleNewest> report_{*this, "report"};
  Provides<SampleTimed> timed_{*this, "timed", &Leaver::produce};
  Provides<Bell> state_{*this, "state", &Leaver::test};
  Probe<std::uint64_t> stops_{*this, "stops"};
  Timer later_{*this, &Leaver::too_late};
};

void add_calls(Plugin& plugin) {
  plugin.add<Caller>("caller", "makes one call at a time, and reports the outcome");
  plugin.add<Leaver>("leaver", "uses its ports when it is told that it ends");
  plugin.add<ThreadCaller>("thread-caller", "makes one call at a time from a thread of its own");
}

}  // namespace fiona::test
