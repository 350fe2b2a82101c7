// Several providers of the same, and who uses them.
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "components.hpp"

namespace fiona::test {

/// One of several that say where something is, and answer.
class Beacon final : public Paced {
 public:
  using Paced::Paced;

 private:
  void tick() override {
    again_after(params_->period_ms());
    if (!params_->fail_with().empty()) throw std::runtime_error(params_->fail_with());
    if (params_->silent()) return;
    if (params_->once() && number_ > 0) {
      fixes_.still_valid();
      last_.still_valid();
      return;
    }
    Fix fix;
    fix.set_source(hull().name());
    fix.set_number(++number_);
    const std::uint64_t each = params_->valid_each();
    fix.set_is_valid(params_->valid() && (each == 0 || number_ % each == 1));
    fix.set_x(params_->x());
    fix.set_y(params_->y());
    fix.set_heading(params_->heading());
    fixes_.put(fix, now() - from_ms(params_->late_ms()));
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
  Timer later_{*this, &Beacon::answer_waiting};
};

/// Uses several beacons, and tells in probes what it heard from whom.
class Navigator final : public Paced {
 public:
  using Paced::Paced;

 private:
  /// "a 1-57, b 12-40, a 80!-": with ! those that were not valid.
  struct Heard {
    std::string text;
    std::string source;
    std::uint64_t last = 0;
    bool valid = true;

    const std::string& add(const Fix& fix, std::uint64_t step) {
      const bool goes_on =
          fix.source() == source && fix.number() == last + step && fix.is_valid() == valid && !text.empty();
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
  void tick() override {
    const auto latest = latest_.latest();
    latest_probe_.set(latest ? "ok " + (*latest)->source() : std::string(to_string(latest.outcome())));
    if (!waits_) {
      waits_ = true;
      hull().spawn(wait(), [] {});
    }
    const double asks_ms = params_->asks_ms();
    if (asks_ms > 0) hull().spawn(ask(), [] {});
    again_after(asks_ms > 0 ? asks_ms : 5);
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
  Requires<Fixes> fresh_{*this, "fresh", &Navigator::on_fix, {.optional = true, .max_age = 1s}};
  Requires<Echo> echo_{*this, "echo", {.optional = true}};
  Requires<Order> orders_{*this, "orders", {.optional = true}};
  Probe<std::string> heard_probe_{*this, "heard"};
  Probe<std::string> last_probe_{*this, "last_heard"};
  Probe<std::string> latest_probe_{*this, "latest_is"};
  Probe<std::string> waited_probe_{*this, "wait_ended", {.doc = "why a wait ended disconnected"}};
  Probe<std::string> answers_probe_{*this, "answers"};
  Probe<std::string> by_probe_{*this, "answered_by"};
};

void add_alternatives(Plugin& plugin) {
  plugin.add<Beacon>("beacon", "says where something is, if it knows");
  plugin.add<Navigator>("navigator", "tells what it heard from which beacon");
}

}  // namespace fiona::test
