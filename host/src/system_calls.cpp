// What is begun in an instance and ends later: a change of mode, a call by hand; and what instances ask for.
#include "fiona/call.hpp"
#include "fiona/error.hpp"
#include "system.hpp"

namespace fiona::host {
namespace {

/// Of a change of mode that names none; and how much longer than the instance itself the host waits for an end.
constexpr double kModeDeadline_ms = 10'000;
constexpr double kGrace_ms = 1'000;

/// What was begun in a group does not outlive its process.
bool is_end_of(const std::string& group, const wire::GroupMessage& event) {
  return event.has_group_ended() && event.group_ended().group() == group;
}

}  // namespace

void System::state(std::uint64_t owner, std::uint64_t id, const control::State& request, Waits::Answer answer) {
  settle();
  const std::string name = request.instance();
  Group& target = group_of(name, model_);
  model_.require_own(name);
  const std::uint64_t change = next_work_++;
  const double within_ms = request.within_ms() > 0 ? request.within_ms() : kModeDeadline_ms;
  const auto begin = [&] {
    target.request(mode_request(name, request.mode(), change, within_ms));
    changing_.insert(name);
  };
  const auto ended = [this, name, answer = std::move(answer)](control::Reply reply) {
    made_.push([this, name] {
      const auto one = changing_.find(name);  // none: it was made, though the request for it was not answered
      if (one != changing_.end()) changing_.erase(one);
    });
    answer(std::move(reply));
  };
  const auto end_of = [made = end_of_mode(change, name + " is " + request.mode()), name,
                       group = target.name()](const wire::GroupMessage& event) {
    if (!is_end_of(group, event)) return made(event);
    return std::optional(failure_reply(
        ErrorCode::ComponentFailed,
        {.what = "'" + name + "' has ended: " + event.group_ended().reason(), .where = name, .next = "show " + name}));
  };
  // The instance itself withdraws a change that is blocked; this is for one that hangs.
  const auto expired =
      failure_reply(ErrorCode::Unreachable,
                    {.what = "'" + name + "' did not change its mode in time: a handler still runs, or it has ended",
                     .where = name,
                     .next = "show " + name});
  waits_->work(owner, id, within_ms + kGrace_ms, begin, end_of, expired, ended);
}

wire::GroupRequest System::mode_request(const std::string& name, const std::string& mode, std::uint64_t change,
                                        double within_ms) {
  wire::GroupRequest request;
  auto& set = *request.mutable_set_mode();
  set.set_instance(name);
  set.set_mode(mode);
  set.set_change(change);
  set.set_within_ms(within_ms);
  return request;
}

/// Of the change of mode of this number; `done` is for people.
Waits::EndOf System::end_of_mode(std::uint64_t change, const std::string& done) {
  return [change, done](const wire::GroupMessage& event) {
    std::optional<control::Reply> reply;
    if (!event.has_mode_set() || event.mode_set().change() != change) return reply;
    reply.emplace().mutable_done()->set_note(done);
    if (event.mode_set().has_failure()) *reply->mutable_failure() = event.mode_set().failure();
    return reply;
  };
}

/// What a call by hand reaches: the port or trigger that is named, of a required port the provider at its wire's end.
control::PortName System::callee(const control::PortName& name) {
  for (const auto& one : model_.instance(name.instance()).interface().ports()) {
    if (one.name() != name.port() || one.direction() != REQUIRES) continue;
    if (model_.wire_of(name)) return served_by(name);
    throw Error(ErrorCode::Usage, {.what = text_of(name) + " has no wire: there is nobody to call", .next = "spots"});
  }
  return name;
}

void System::call(std::uint64_t owner, std::uint64_t id, const control::Call& request, Waits::Answer answer) {
  const control::PortName name = callee(request.target());
  Group& target = group_of(name.instance(), model_);
  const std::uint64_t run = next_work_++;
  const double within_ms = request.within_ms() > 0 ? request.within_ms() : 1e3 * to_seconds(kDefaultDeadline);
  const TimePoint begun = clock_->now();
  const auto begin = [&] {
    wire::GroupRequest call;
    call.mutable_call()->set_run(run);
    *call.mutable_call()->mutable_target() = name;
    *call.mutable_call()->mutable_arguments() = request.arguments();
    call.mutable_call()->set_within_ms(within_ms);
    target.request(std::move(call));
  };
  const auto end_of = [this, run, begun, group = target.name()](const wire::GroupMessage& event) {
    std::optional<control::Reply> reply;
    if (is_end_of(group, event)) {
      wire::CallEnded ended;
      ended.set_run(run);
      ended.set_outcome(static_cast<std::uint32_t>(Outcome::Disconnected));
      ended.set_reason(event.group_ended().reason());
      *reply.emplace().mutable_called() = called(ended, begun);
    }
    const bool ends = event.has_call_ended() && event.call_ended().run() == run;
    if (ends) *reply.emplace().mutable_called() = called(event.call_ended(), begun);
    return reply;
  };
  control::Reply expired;
  expired.mutable_called()->set_run(run);
  expired.mutable_called()->set_outcome(std::string(to_string(Outcome::Timeout)));
  expired.mutable_called()->set_reason("the instance does not answer");
  const auto given_up = [this, run, group = target.name()] {
    wire::GroupRequest notice;
    notice.mutable_give_up_call()->set_run(run);
    if (Group* at = groups_.living(group)) at->tell(std::move(notice));
  };
  waits_->work(owner, id, within_ms + kGrace_ms, begin, end_of, expired, std::move(answer), given_up);
}

/// What a client is told of a call that has ended.
control::Called System::called(const wire::CallEnded& ended, TimePoint begun) const {
  control::Called told;
  told.set_run(ended.run());
  told.set_outcome(std::string(to_string(static_cast<Outcome>(ended.outcome()))));
  told.set_reason(ended.reason());
  told.set_after_ms(1e3 * to_seconds(clock_->now() - begun));
  if (ended.type().empty()) return told;
  told.mutable_result()->set_type(ended.type());
  told.mutable_result()->set_object(ended.object());
  if (const auto object = types_.make(ended.type())) {
    *told.mutable_result()->mutable_files() = Types::files_of(*object->GetDescriptor()->file());
  }
  return told;
}

bool System::has_asked(const wire::Asked& asked) const {
  const Model::Instance* one = model_.find(asked.instance());
  if (!one || one->led) return false;
  return asked.group().empty() ? !host_of(one->group).empty() : one->group == asked.group();
}

/// Loaded again it has another place in the order, started again or in another version another process.
std::string System::life_of(const std::string& instance) const {
  const Model::Instance* one = model_.find(instance);
  const Group* at = one ? groups_.find(one->group) : nullptr;
  return at ? std::to_string(one->order) + " " + at->endpoint() : "";
}

void System::answer(const wire::Asked& asked, const control::Reply& reply) {
  const Model::Instance* one = model_.find(asked.instance());
  Group* at = one ? groups_.living(one->group) : nullptr;
  if (!at) return;
  wire::GroupRequest request;
  request.mutable_answered()->set_instance(asked.instance());
  request.mutable_answered()->set_number(asked.number());
  *request.mutable_answered()->mutable_reply() = reply;
  at->tell(std::move(request));
}

}  // namespace fiona::host
