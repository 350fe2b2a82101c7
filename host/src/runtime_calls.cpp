// Calls of ports and triggers by hand; and answers to what an instance has asked for.
#include <fmt/format.h>

#include "fiona/error.hpp"
#include "fiona/readable_text.hpp"
#include "runtime.hpp"

namespace fiona::host {
namespace {

std::shared_ptr<Object> object_from(const google::protobuf::Descriptor& type,
                                    const google::protobuf::RepeatedPtrField<control::Argument>& arguments) {
  std::shared_ptr<Object> object(google::protobuf::MessageFactory::generated_factory()->GetPrototype(&type)->New());
  set_fields(*object, std::vector<control::Argument>(arguments.begin(), arguments.end()));
  return object;
}

}  // namespace

/// Tells the host, once, how a call by hand has ended.
class Runtime::CallReply final : public ReplySink {
 public:
  CallReply(std::uint64_t run, const OnEvent& on_event, Clock& clock) : run_(run), on_event_(on_event), clock_(clock) {}

  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) override {
    if (ended_.exchange(true)) return;
    clock_.cancel(timer_);
    if (const std::size_t bytes = object ? object->ByteSizeLong() : 0; bytes > kMostCopied) {
      outcome = Outcome::Rejected;
      reason = fmt::format("the answer is too large: {} bytes, of at most {} that can be shown", bytes, kMostCopied);
      object.reset();
    }
    wire::GroupMessage message;
    auto& ended = *message.mutable_call_ended();
    ended.set_run(run_);
    ended.set_outcome(static_cast<std::uint32_t>(outcome));
    ended.set_reason(readable_text(reason));
    if (object) ended.set_type(object->GetDescriptor()->full_name());
    if (object) object->SerializeToString(ended.mutable_object());
    on_event_(std::move(message));
  }
  /// Nobody waits any more.
  void give_up(Outcome why) {
    answer(why, {}, nullptr);
    abandon();
  }
  /// What ends it otherwise: one that has ended meanwhile does not need it.
  void set_timer(TimerId timer) {
    timer_ = timer;
    if (ended_) clock_.cancel(timer);
  }

 private:
  const std::uint64_t run_;
  const OnEvent& on_event_;
  Clock& clock_;
  std::atomic<bool> ended_{false};
  std::atomic<TimerId> timer_{0};
};

void Runtime::call(const wire::Call& request) {
  Hull& hull = *find(request.target().instance()).hull;
  auto reply = std::make_shared<CallReply>(request.run(), on_event_, clock_);
  if (auto* trigger = hull.find_trigger(request.target().port())) {
    trigger->call(object_from(trigger->argument(), request.arguments()), reply);
  } else {
    call_port(hull, request, reply);
  }
  const TimePoint end = saturating_sum(clock_.now(), from_milliseconds(request.within_ms()));
  reply->set_timer(clock_.schedule(end, hull.shared_strand(), [reply] { reply->give_up(Outcome::Timeout); }));
  std::erase_if(calls_, [](const auto& one) { return one.second.expired(); });
  calls_[request.run()] = reply;
}

void Runtime::give_up_call(const wire::GiveUpCall& request) {
  const auto found = calls_.find(request.run());
  const auto reply = found == calls_.end() ? nullptr : found->second.lock();
  if (reply) reply->give_up(Outcome::Cancelled);
}

void Runtime::call_port(const Hull& hull, const wire::Call& request, const std::shared_ptr<ReplySink>& reply) {
  Port* port = hull.find_port(request.target().port());
  if (!port) {
    std::vector<std::string> known;
    for (const auto* one : hull.triggers()) known.push_back(one->name());
    for (const auto* one : hull.ports()) known.push_back(one->name());
    throw Error(ErrorCode::NotFound,
                {.what = "'" + hull.name() + "' has no port or trigger '" + request.target().port() + "'",
                 .next = "show " + hull.name(),
                 .near = nearest_names(request.target().port(), known)});
  }
  auto* provided = dynamic_cast<ProvidedPort*>(port);
  const Pattern pattern = port->service().pattern();
  if (!provided || (pattern != QUERY && pattern != SEND)) {
    throw Error(ErrorCode::Usage,
                {.what = port->full_name() + " speaks " + std::string(to_string(pattern)) + ": it cannot be called",
                 .expected = "a query or send port, or a trigger",
                 .next = "watch " + port->full_name()});
  }
  auto object = object_from(port->service().object(), request.arguments());
  const std::size_t bytes = object->ByteSizeLong();
  const Outcome outcome =
      provided->inbox()->push({Envelope{std::move(object), request.run(), clock_.now(), bytes}, reply});
  if (outcome != Outcome::Ok || pattern == SEND) reply->answer(outcome, {}, nullptr);
}

/// What an instance has asked its host for; it may have ended meanwhile.
void Runtime::answered(const wire::Answered& answer) {
  const auto found = instances_.find(answer.instance());
  if (found != instances_.end()) found->second->hull->answer(answer.number(), answer.reply());
}

}  // namespace fiona::host
