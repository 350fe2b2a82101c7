#include "pattern_components.hpp"

#include <atomic>
#include <chrono>
#include <map>
#include <string>
#include <thread>

#include "fiona/test/patterns.fiona.hpp"
#include "fiona/test/test.fiona.hpp"

namespace fiona::test {

using namespace std::chrono_literals;

/// Hears messages of every pattern, and counts what came out of its order and what ran while something else did.
class Listener final : public Component {
 public:
  using Component::Component;

 private:
  /// Something of this component runs.
  class Running {
   public:
    explicit Running(Listener& of) : of_(of) {
      if (of_.running_.exchange(true)) of_.overlaps_.set(++of_.overlapped_);
      std::this_thread::sleep_for(50us);  // long enough for another thread to come in, if one could
    }
    ~Running() { of_.running_ = false; }

   private:
    Listener& of_;
  };

  void note(const std::string& from, std::uint64_t number) {
    std::uint64_t& last = last_[from];
    if (number <= last) disorder_.set(from + ": " + std::to_string(number) + " after " + std::to_string(last));
    if (last > 0 && number > last + longest_) step_.set(longest_ = number - last);
    last = number;
  }
  void on_sample(const Sample& sample) {
    const Running running(*this);
    note("samples", sample.number());
    samples_heard_.set(++heard_[0]);
  }
  void on_other(const Sample& sample) {
    const Running running(*this);
    note("others", sample.number());
    others_heard_.set(++heard_[1]);
  }
  void on_order(const Sample& sample) {
    const Running running(*this);
    note("orders", sample.number());
    orders_heard_.set(++heard_[2]);
  }
  Reply on_question(const Question& question) {
    const Running running(*this);
    note("questions", question.number());
    questions_heard_.set(++heard_[3]);
    Reply reply;
    reply.set_number(question.number());
    return reply;
  }
  void on_ring(const Fired<Crossing>& crossing) {
    const Running running(*this);
    note("rings", crossing->seen());
    rings_heard_.set(++heard_[4]);
  }
  void look() { const Running running(*this); }
  /// The answer says which of these calls it was to run, and how many times it has run.
  Reply count_call(const Question& question) {
    const Running running(*this);
    note("calls", question.number());
    Reply reply;
    reply.set_number(++called_);
    reply.set_payload(std::to_string(question.number()));
    return reply;
  }
  Async<Reply> count_later(const Question& question) {
    note("later calls", question.number());
    const std::uint64_t number = ++called_later_;
    static_cast<void>(co_await quiet_.wait_update(5ms));
    Reply reply;
    reply.set_number(number);
    reply.set_payload(std::to_string(question.number()));
    co_return reply;
  }
  Async<Reply> listen(const Question&) {
    Threshold threshold;
    threshold.set_every(1);
    const auto id = co_await bell_.activate(EventMode::Continuous, std::move(threshold));
    Reply reply;
    reply.set_number(static_cast<std::uint64_t>(id.outcome()));
    co_return reply;
  }

  std::atomic<bool> running_{false};
  std::uint64_t overlapped_ = 0;
  std::map<std::string, std::uint64_t> last_;
  std::uint64_t longest_ = 0;
  std::map<int, std::uint64_t> heard_;
  std::uint64_t called_ = 0;
  std::uint64_t called_later_ = 0;
  Requires<SampleNewest> samples_{*this, "samples", &Listener::on_sample, {.optional = true}};
  Requires<SampleNewest> others_{*this, "others", &Listener::on_other, {.optional = true}};
  Requires<Bell> bell_{*this, "bell", &Listener::on_ring, {.optional = true}};
  Provides<Order> orders_{*this, "orders", &Listener::on_order};
  Provides<Echo> echo_{*this, "echo", &Listener::on_question};
  Requires<SampleNewest> quiet_{*this, "quiet", {.optional = true}};
  Trigger<Question, Reply> count_call_{*this, "count_call", &Listener::count_call};
  Trigger<Question, Reply> count_later_{*this, "count_later", &Listener::count_later};
  Trigger<Question, Reply> listen_{*this, "listen", &Listener::listen};
  Probe<std::string> disorder_{*this, "disorder", {.doc = "what came out of its order last"}};
  Probe<std::uint64_t> step_{*this, "step", {.doc = "the longest from one number to the next"}};
  Probe<std::uint64_t> overlaps_{*this, "overlaps"};
  Probe<std::uint64_t> samples_heard_{*this, "samples_heard"};
  Probe<std::uint64_t> others_heard_{*this, "others_heard"};
  Probe<std::uint64_t> orders_heard_{*this, "orders_heard"};
  Probe<std::uint64_t> questions_heard_{*this, "questions_heard"};
  Probe<std::uint64_t> rings_heard_{*this, "rings_heard"};
  Task looker_{*this, "looker", 1ms, &Listener::look};
};

/// Has parameters of which each is sound alone, and not with every value of the others.
class Clerk final : public Component {
 public:
  using Component::Component;
  void on_start() override { pace_.set(params_->pace()); }

 private:
  void check(const ClerkParams& draft) const {
    if (draft.high() - draft.low() == draft.width()) return;
    throw Error(ErrorCode::Failed, {.what = "width is not what is between low and high", .where = name()});
  }
  void on_change() {
    changes_.set(++changed_);
    pace_.set(params_->pace());
  }
  void look() {
    const double width = params_->width();
    std::this_thread::sleep_for(100us);
    if (params_->high() - params_->low() != width) torn_.set(++tears_);
    looks_.set(++looked_);
  }

  std::uint64_t changed_ = 0;
  std::uint64_t tears_ = 0;
  std::uint64_t looked_ = 0;
  Params<ClerkParams> params_{*this, &Clerk::check, &Clerk::on_change};
  Probe<std::uint64_t> changes_{*this, "changes"};
  Probe<Pace> pace_{*this, "pace"};
  Probe<std::uint64_t> torn_{
      *this, "torn", {.doc = "how often a task saw the old value of one and the new one of another"}};
  Probe<std::uint64_t> looks_{*this, "looks"};
  Task looker_{*this, "looker", 1ms, &Clerk::look};
};

/// Produces a sample each 40 ms, twice as slow as its service says, unless it is stopped.
class Metronome final : public Component {
 public:
  using Component::Component;
  void on_start() override {
    if (params_->stopped()) samples_.stop();
  }

 private:
  void on_change() {
    params_->stopped() ? samples_.stop() : samples_.start();
    put_outcome_.set(std::string(to_string(samples_.put(numbered()))));
  }
  void produce() {
    if (params_->work_ms() > 0)
      std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(params_->work_ms()));
    samples_.put(numbered());
  }
  Sample numbered() {
    Sample one;
    one.set_number(++number_);
    return one;
  }

  std::uint64_t number_ = 0;
  Params<MetronomeParams> params_{*this, nullptr, &Metronome::on_change};
  Provides<SampleTimed> samples_{*this, "samples", &Metronome::produce, 40ms};
  Probe<std::string> put_outcome_{*this, "put_outcome", {.doc = "of a put of its own, right after the last change"}};
};

/// Chooses how much of a push timed it wants by the cycle of whoever provides it.
class Follower final : public Component {
 public:
  using Component::Component;

 private:
  void look() {
    const auto cycle = samples_.cycle();
    cycle_.set(cycle ? std::chrono::duration<double, std::milli>(*cycle).count() : -1);
    outcome_.set(std::string(to_string(cycle.outcome())));
  }

  Requires<SampleTimed> samples_{*this, "samples", {.optional = true}};
  Probe<double> cycle_{*this, "cycle", {.unit = "ms"}};
  Probe<std::string> outcome_{*this, "outcome"};
  Task looker_{*this, "looker", 2ms, &Follower::look};
};

void add_pattern_components(Plugin& plugin) {
  plugin.add<Listener>("listener", "hears every pattern, and tells what came out of order");
  plugin.add<Metronome>("metronome", "produces at a pace of its own");
  plugin.add<Follower>("follower", "asks for the pace");
  plugin.add<Clerk>("clerk", "has parameters that depend on each other");
}

}  // namespace fiona::test
