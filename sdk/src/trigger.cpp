#include "fiona/trigger.hpp"

#include "fiona/hull.hpp"

namespace fiona::detail {

TriggerBase::TriggerBase(Component& owner, std::string_view name, const google::protobuf::Descriptor& argument,
                         const google::protobuf::Descriptor& result, const TriggerOptions& options, Handler handler)
    : hull_(owner.hull()),
      name_(name),
      doc_(options.doc),
      activity_(options.activity),
      argument_(argument),
      result_(result),
      rules_(argument),
      handler_(std::move(handler)) {
  hull_.add(*this);
}

/// Counts the call as ended, then passes the outcome on: who has its answer may call again.
class TriggerBase::Counted final : public ReplySink {
 public:
  Counted(std::shared_ptr<ReplySink> reply, std::shared_ptr<std::atomic<int>> calls)
      : reply_(std::move(reply)), calls_(std::move(calls)) {}
  ~Counted() override { end(); }
  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) override {
    end();
    reply_->answer(outcome, std::move(reason), std::move(object));
  }

 private:
  void end() {
    if (!ended_.exchange(true)) --*calls_;
  }

  const std::shared_ptr<ReplySink> reply_;
  const std::shared_ptr<std::atomic<int>> calls_;
  std::atomic<bool> ended_{false};
};

void TriggerBase::call(std::shared_ptr<const Object> argument, std::shared_ptr<ReplySink> reply) {
  if (++*calls_ > kMaxCalls) {
    --*calls_;
    return reply->answer(Outcome::Rejected, "too many calls of '" + name_ + "' are under way", nullptr);
  }
  auto counted = std::make_shared<Counted>(reply, calls_);
  reply->set_on_abandon([given_up = std::weak_ptr(counted)] {
    if (const auto one = given_up.lock()) one->note_abandoned();
  });
  const bool taken = hull_.strand().post([this, argument = std::move(argument), counted] { run(argument, counted); });
  if (!taken) reply->answer(Outcome::Disconnected, "the instance has ended", nullptr);
}

void TriggerBase::run(const std::shared_ptr<const Object>& argument, std::shared_ptr<ReplySink> reply) {
  if (reply->abandoned()) return;  // nobody waits for it any more
  if (const auto violation = rules_.first_violation(*argument)) {
    return reply->answer(Outcome::Rejected, "the argument was refused: " + *violation, nullptr);
  }
  const std::string mode = hull_.mode();
  if (!hull_.serves(mode, activity_) || hull_.is_leaving(activity_)) {
    return reply->answer(Outcome::NotActive, "mode " + mode, nullptr);
  }
  std::optional<Async<>> coroutine;
  hull_.strand().begins(Liveness::mark("trigger '" + name_ + "'"));
  hull_.guarded([&] { coroutine = handler_(*argument, std::move(reply)); });
  if (!coroutine) return;
  ActivityHold* held = nullptr;
  if (auto hold = hull_.acquire(activity_, "trigger '" + name_ + "'")) {
    held = holds_.emplace_back(std::make_shared<ActivityHold>(std::move(*hold))).get();
  }
  // The coroutine refers to the argument, which lives as long as this. The hold goes no later than the component: a job
  // that the strand drops at its end may outlive the hull.
  hull_.spawn(std::move(*coroutine),
              [this, argument, held] { std::erase_if(holds_, [held](const auto& one) { return one.get() == held; }); });
}

}  // namespace fiona::detail
