// What virtual time has to wait for.
#include <cstdlib>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "components.hpp"

namespace fiona::test {

/// Uses every pattern at random, on a grid of milliseconds so that much falls into the same instant. What it does next
/// depends on everything that it has received and on the order of that, and it tells in all that it sends: one message
/// out of order anywhere changes all that comes after.
class Mingler final : public Component {
 public:
  using Component::Component;
  void on_start() override {
    mix(params_->seed());
    began_.set(to_seconds(clock_start() - TimePoint()));
  }
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
  void second() { newest_.put(sample()); }
  void follow() { mix(9); }
  void look() {
    const auto latest = waited_.latest();
    mix(latest ? (*latest)->number() : 10);
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
  Probe<double> began_{*this, "began", {.unit = "s", .doc = "its clock, since 1970"}};
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
  Requires<SampleNewest> newest_in_{
      *this, "newest_in", &Mingler::on_newest, {.optional = true, .delivery = Delivery::Newest}};
  Requires<SampleNewest> waited_{*this, "waited_in", {.optional = true}};
  Requires<SampleLast> last_in_{*this, "last_in", &Mingler::on_last, {.optional = true}};
  Requires<SampleLeased> leased_in_{*this, "leased_in", &Mingler::on_leased, {.optional = true}};
  Requires<SampleTimed> timed_in_{*this, "timed_in", &Mingler::on_timed, {.optional = true}};
  Requires<Bell> bell_out_{*this, "bell_in", {.optional = true}};
  Requires<Echo> echo_out_{*this, "echo_in", {.optional = true}};
  Requires<Order> orders_out_{*this, "orders_in", {.optional = true}};
  Task second_{*this, "second", on(each_, 2), &Mingler::second};
  Task follow_{*this, "follow", after(second_), &Mingler::follow};
  Task look_{*this, "look", on(waited_), &Mingler::look};
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
  void stay() {
    if (params_->die()) std::_Exit(3);
    std::this_thread::sleep_for(from_ms(params_->for_ms()));
  }
  Params<HogParams> params_{*this};
  Timer begin_{*this, &Hog::stay};
};

/// Puts what it hears, and something to begin with.
class Turner final : public Component {
 public:
  using Component::Component;
  void on_mode(std::string_view mode) override {
    if (mode == kModeActive) begin_.at(now() + 10ms);
  }

 private:
  void begin() { out_.put(Sample()); }
  void on_sample(const Sample& sample) { out_.put(sample); }
  Provides<SampleNewest> out_{*this, "out"};
  Requires<SampleNewest> in_{*this, "in", &Turner::on_sample, {.optional = true}};
  Timer begin_{*this, &Turner::begin};
};

void add_virtual_time(Plugin& plugin) {
  plugin.add<Mingler>("mingler", "uses every pattern at random");
  plugin.add<Turner>("turner", "puts what it hears");
  plugin.add<Hog>("hog", "stays in a handler, or ends its process");
}

}  // namespace fiona::test
