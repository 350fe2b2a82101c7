// What holds an activity, in every way that there is.
#include <coroutine>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <thread>
#include <utility>

#include "components.hpp"

namespace fiona::test {

/// Holds its activity `hold` by a coroutine of each kind and by a thread, each until its own gate is opened. `held`
/// names those that have come to their gates, in the order of the alphabet.
class Holder final : public Component {
 public:
  using Component::Component;

 private:
  /// What a coroutine of this kind waits for.
  struct Gate {
    Holder& of;
    std::string_view kind;
    bool await_ready() const noexcept { return false; }
    void await_suspend(std::coroutine_handle<> self) {
      of.waiting_[std::string(kind)] = self;
      of.note(kind, true);
    }
    void await_resume() const { of.note(kind, false); }
  };

  void note(std::string_view kind, bool holds) {
    const std::lock_guard lock(mutex_);
    holds ? void(holding_.emplace(kind)) : void(holding_.erase(std::string(kind)));
    if (holds) begun_.set(++begins_);
    std::string text;
    for (const auto& one : holding_) text += (text.empty() ? "" : " ") + one;
    held_.set(text);
  }
  bool wants(const std::string& kind) {
    const std::lock_guard lock(mutex_);
    return wanted_.contains(kind);
  }
  Async<> work() {
    if (wants("task")) co_await Gate{*this, "task"};
  }
  void thread(const OwnThread& own) {
    if (!wants("thread")) return void(own.wait_for(1ms));
    note("thread", true);
    while (wants("thread")) std::this_thread::sleep_for(1ms);
    note("thread", false);
  }
  Async<> on_notice(const Sample&) { co_await Gate{*this, "push"}; }
  Async<> on_order(const Sample&) { co_await Gate{*this, "send"}; }
  Async<> on_ring(const Crossing&) { co_await Gate{*this, "event"}; }
  Async<Reply> on_question(const Question&) {
    co_await Gate{*this, "query"};
    co_return Reply();
  }
  Async<TurnResult> turn(const TurnRequest&) {
    co_await Gate{*this, "trigger"};
    co_return TurnResult();
  }
  /// The periodic task and the thread begin to hold.
  Reply begin(const Question& question) {
    const std::lock_guard lock(mutex_);
    wanted_.insert(question.manner());
    return {};
  }
  Reply open(const Question& question) {
    {
      const std::lock_guard lock(mutex_);
      wanted_.erase(question.manner());
    }
    if (const auto waits = waiting_.extract(question.manner())) waits.mapped().resume();
    return {};
  }
  Async<Reply> listen(const Question&) {
    Threshold each;
    each.set_every(1);
    const auto id = co_await bell_.activate(EventMode::Continuous, std::move(each));
    if (!id) throw Error(ErrorCode::Failed, "the event was not activated");
    co_return Reply();
  }
  void look() { looks_.set(++looked_); }

  std::mutex mutex_;
  std::set<std::string> holding_;  ///< guarded, as are the next two
  std::set<std::string> wanted_;
  std::uint64_t begins_ = 0;
  std::map<std::string, std::coroutine_handle<>> waiting_;
  std::uint64_t looked_ = 0;
  Modes modes_{*this, {{"work", {"hold", "look"}}, {"rest", {"look"}}}};
  Probe<std::string> held_{*this, "held", {.doc = "who holds the activity now"}};
  Probe<std::uint64_t> begun_{*this, "begun", {.doc = "how often anything has begun to hold it"}};
  Probe<std::uint64_t> looks_{*this, "looks"};
  Requires<SampleNewest> notices_{*this, "notices", &Holder::on_notice, {.optional = true, .activity = "hold"}};
  Requires<Bell> bell_{*this, "bell", &Holder::on_ring, {.optional = true, .activity = "hold"}};
  Provides<Order> orders_{*this, "orders", &Holder::on_order, {.activity = "hold"}};
  Provides<Echo> echo_{*this, "echo", &Holder::on_question, {.activity = "hold"}};
  Trigger<TurnRequest, TurnResult> turn_{*this, "turn", &Holder::turn, {.activity = "hold"}};
  Trigger<Question, Reply> begin_{*this, "begin", &Holder::begin};
  Trigger<Question, Reply> open_{*this, "open", &Holder::open};
  Trigger<Question, Reply> listen_{*this, "listen", &Holder::listen};
  Task work_{*this, "work", 2ms, &Holder::work, "hold"};
  Task thread_{*this, "thread", free_running, &Holder::thread, "hold"};
  Task look_{*this, "look", 2ms, &Holder::look, "look"};
};

/// Puts, sends, asks or rings once for each call of `prompt`, whose manner says which.
class Prompter final : public Component {
 public:
  using Component::Component;

 private:
  Reply prompt(const Question& question) {
    if (question.manner() == "push") notices_.put(Sample());
    if (question.manner() == "send") orders_.send(Sample());
    if (question.manner() == "event") {
      Sample state;
      state.set_number(++rung_);
      bell_.put(state);
    }
    if (question.manner() == "query") spawn(ask());
    return {};
  }
  Async<> ask() {
    const auto answer = co_await echo_.query(Question(), 60s);
    answered_.set(std::to_string(++ends_) + " " + std::string(to_string(answer.outcome())));
  }
  std::optional<Crossing> test(Threshold& threshold, const Sample& now) {
    threshold.set_seen(threshold.seen() + 1);
    Crossing crossing;
    crossing.set_number(now.number());
    crossing.set_seen(threshold.seen());
    crossing.set_payload(threshold.payload());
    return crossing;
  }

  std::uint64_t rung_ = 0;
  std::uint64_t ends_ = 0;
  Provides<SampleNewest> notices_{*this, "notices"};
  Provides<Bell> bell_{*this, "bell", &Prompter::test};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
  Requires<Echo> echo_{*this, "echo", {.optional = true}};
  Probe<std::string> answered_{
      *this, "answered", {.doc = "how many of its questions have ended, and how the last one"}};
  Trigger<Question, Reply> prompt_{*this, "prompt", &Prompter::prompt};
};

void add_holding(Plugin& plugin) {
  plugin.add<Holder>("holder", "holds an activity in every way");
  plugin.add<Prompter>("prompter", "gives others something to do");
}

}  // namespace fiona::test
