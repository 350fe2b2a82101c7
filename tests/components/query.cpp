// Queries: who answers, who asks.
#include <algorithm>
#include <map>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "components.hpp"

namespace fiona::test {

/// Answers in the manner that the question asks for.
class Answerer final : public Component {
 public:
  using Component::Component;

 private:
  void on_question(const Question& question, fiona::Reply<Reply> reply) {
    if (question.manner() == "drop") return;
    if (question.manner() == "throw") throw std::runtime_error("asked to throw");
    if (question.manner() == "latin")
      throw std::runtime_error(
          "Stra\xdf"
          "e");
    if (question.manner() == "long") {
      std::string reason = "x";
      for (int i = 0; i < 5000; ++i) reason += "\u00fc";
      return reply.reject(reason);
    }
    if (question.manner() == "hang") std::this_thread::sleep_for(500ms);
    if (question.manner() == "stand") std::this_thread::sleep_for(2s);
    if (question.manner() == "stick") std::this_thread::sleep_for(6s);
    if (question.manner() == "error") return reply.reject("asked to refuse");
    if (question.manner() == "release" || question.manner() == "forget") let_go(question.manner() == "release");
    const bool for_another = question.manner() == "second" && name() != "second";
    Reply answer;
    answer.set_number(question.number());
    answer.set_payload(question.payload());
    if (question.manner() == "never" || for_another) {
      kept_.emplace_back(std::move(answer), std::move(reply));
      return;
    }
    if (question.manner() == "large") answer.mutable_payload()->resize(20U << 20U);
    if (question.manner() == "later") {
      if (waiting_.empty()) later_.at(now() + 50ms);
      waiting_.emplace_back(std::move(answer), std::move(reply));
      return;
    }
    reply.answer(std::move(answer));
  }
  /// Of what is kept.
  void let_go(bool answers) {
    for (auto& [answer, reply] : std::exchange(kept_, {})) {
      if (answers) reply.answer(std::move(answer));
    }
  }
  void answer_waiting() {
    for (auto& [answer, reply] : std::exchange(waiting_, {})) reply.answer(std::move(answer));
  }

  void look() {
    open_.set(kept_.size());
    abandoned_.set(static_cast<std::uint64_t>(
        std::count_if(kept_.begin(), kept_.end(), [](const auto& one) { return one.second.abandoned(); })));
  }

  std::vector<std::pair<Reply, fiona::Reply<Reply>>> kept_;
  std::vector<std::pair<Reply, fiona::Reply<Reply>>> waiting_;
  Provides<Echo> echo_{*this, "echo", &Answerer::on_question};
  Provides<Lookup> lookup_{*this, "lookup", &Answerer::on_question};
  Probe<std::uint64_t> open_{*this, "open", {.doc = "questions that are not answered"}};
  Probe<std::uint64_t> abandoned_{*this, "abandoned", {.doc = "those of them for which nobody waits any more"}};
  Task looker_{*this, "looker", 5ms, &Answerer::look};
  Timer later_{*this, &Answerer::answer_waiting};
};

/// Asks once a period; reports the `number` of the question and the outcome in `value`, its reason in `payload`.
class Asker final : public Paced {
 public:
  using Paced::Paced;

 private:
  void tick() override {
    if (params_->count() > 0 && asked_ >= params_->count()) return;
    ++asked_;
    hull().spawn(ask(asked_), [] {});
    again_after(params_->period_ms());
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
};

/// Asks `count` questions, each when the one before is answered; reports the median round trip in `value`, the
/// 99th percentile in `sent_ns`.
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
    report.set_sent_ns(times_ns[times_ns.size() * 99 / 100]);
    report_.put(std::move(report));
  }

  Params<FloodParams> params_{*this};
  Requires<Echo> echo_{*this, "echo"};
  Provides<SampleLast> report_{*this, "report"};
};

/// Asks many questions at once through the port that its argument names, each on its own; tells how they end, and how
/// many a port can have open at once.
class Questioner final : public Component {
 public:
  using Component::Component;

 private:
  /// `number` questions of the manner "PORT:MANNER".
  Reply ask(const Question& request) {
    const std::string port = request.manner().substr(0, request.manner().find(':'));
    Question question;
    question.set_manner(request.manner().substr(port.size() + 1));
    question.mutable_payload()->resize(params_->payload());
    for (std::uint64_t i = 0; i < request.number(); ++i) {
      ++open_;
      spawn(port == "lookup" ? one(lookup_, question) : one(port == "echo" ? echo_ : failing_echo_, question));
    }
    tell();
    return {};
  }
  template <class P>
  Async<> one(P& port, Question question) {
    question.set_number(++asked_);
    const auto answer = co_await port.query(std::move(question), from_ms(params_->deadline_ms()));
    --open_;
    ++ended_[answer.outcome()];
    tell();
  }
  void tell() {
    std::string text;
    for (const auto& [outcome, count] : ended_)
      text += std::string(to_string(outcome)) + "=" + std::to_string(count) + " ";
    text += "open=" + std::to_string(open_);
    ends_.set(text);
  }
  void on_change() {
    for (auto* port : {&echo_, &failing_echo_}) port->cancel_calls(params_->cancel() == "port");
    lookup_.cancel_calls(params_->cancel() == "port");
  }
  /// How many requests its port takes until it has too many open; it gives them up again.
  Reply room(const Question& request) {
    Reply reply;
    reply.set_number(request.manner() == "lookup" ? room_of(lookup_)
                                                  : room_of(request.manner() == "echo" ? echo_ : failing_echo_));
    return reply;
  }
  template <class P>
  static std::uint64_t room_of(P& port) {
    std::vector<QueryId> ids;
    Question never;
    never.set_manner("never");
    for (auto id = port.request(never, 60s); id; id = port.request(never, 60s)) ids.push_back(*id);
    for (const QueryId id : ids) port.discard(id);
    return ids.size();
  }

  std::uint64_t asked_ = 0;
  std::uint64_t open_ = 0;
  std::map<Outcome, std::uint64_t> ended_;
  Params<CallerParams> params_{*this, nullptr, &Questioner::on_change};
  Requires<Echo> echo_{*this, "echo", {.optional = true}};
  Requires<Echo> failing_echo_{*this, "failing_echo", {.optional = true, .at_rewire = AtRewire::Fail}};
  Requires<Lookup> lookup_{*this, "lookup", {.optional = true, .at_rewire = AtRewire::Redirect}};
  Probe<std::string> ends_{*this, "ends", {.doc = "how many questions have ended in which way, and how many are open"}};
  Trigger<Question, Reply> ask_{*this, "ask", &Questioner::ask};
  Trigger<Question, Reply> room_{*this, "room", &Questioner::room};
};

void add_query(Plugin& plugin) {
  plugin.add<Answerer>("answerer", "answers in the manner asked for");
  plugin.add<Asker>("asker", "asks, and reports the outcome");
  plugin.add<Questioner>("questioner", "asks many questions at once, and counts how they end");
  plugin.add<Prober>("prober", "measures how long an answer takes");
}

}  // namespace fiona::test
