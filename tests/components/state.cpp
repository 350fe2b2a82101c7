// Modes, activities and triggers.
#include <stdexcept>
#include <string>

#include "components.hpp"

namespace fiona::test {

/// Has three main modes: `drive` and `park` share the activity `look`; `rest` has none.
class Mover final : public Component {
 public:
  using Component::Component;

 private:
  void look() {
    sees_.set(hull().mode());
    looks_.put(numbered(++looked_));
  }
  Async<> steer() {
    if (params_->work_ms() > 0) {
      const auto most = from_ms(params_->work_ms());
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
    if (request.manner() == "held") {
      co_await wait_at_gate();
    } else {
      static_cast<void>(co_await orders_in_.wait_update(50ms));
    }
    co_return turn(request);
  }
  Async<> on_notice(const Sample&) { co_await wait_at_gate(); }
  Async<Reply> on_question(const Question& question) {
    Reply answer;
    answer.set_number(question.number());
    co_await wait_at_gate();
    co_return answer;
  }
  Async<> wait_at_gate() {
    held_.set(++held_so_far_);
    static_cast<void>(co_await gate_.wait_update(60s));
  }
  static Sample numbered(std::uint64_t number) {
    Sample one;
    one.set_number(number);
    return one;
  }

  std::uint64_t looked_ = 0;
  std::uint64_t steered_ = 0;
  std::uint64_t held_so_far_ = 0;
  int heading_ = 0;
  Modes modes_{*this, {{"drive", {"look", "steer"}}, {"park", {"look"}}, {"rest", {}}}};
  Params<MoverParams> params_{*this};
  Probe<std::string> sees_{*this, "sees", {.doc = "the mode in which it finds itself"}};
  Provides<SampleNewest> looks_{*this, "looks"};
  Provides<SampleNewest> steers_{*this, "steers"};
  Provides<SampleNewest> outcome_{*this, "outcome"};
  Requires<SampleNewest> orders_in_{*this, "orders", {.optional = true, .activity = "steer"}};
  Requires<SampleNewest> gate_{*this, "gate", {.optional = true, .activity = "steer"}};
  Requires<SampleNewest> notices_{*this, "notices", &Mover::on_notice, {.optional = true, .activity = "steer"}};
  Provides<Echo> echo_{*this, "echo", &Mover::on_question, {.activity = "steer"}};
  Probe<std::uint64_t> held_{*this, "held", {.doc = "how many coroutines have come to wait at the gate"}};
  Trigger<TurnRequest, TurnResult> turn_{
      *this, "turn", &Mover::turn, {.doc = "turns on the spot", .activity = "steer"}};
  Trigger<TurnRequest, TurnResult> turn_later_{*this, "turn_later", &Mover::turn_later, {.activity = "steer"}};
  Task look_{*this, "look", 5ms, &Mover::look, "look"};
  Task steer_{*this, "steer", 5ms, &Mover::steer, "steer"};
};

void add_state(Plugin& plugin) { plugin.add<Mover>("mover", "has modes that share activities"); }

}  // namespace fiona::test
