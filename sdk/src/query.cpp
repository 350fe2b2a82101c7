#include "fiona/query.hpp"

#include <utility>
#include <vector>

#include "fiona/hull.hpp"

namespace fiona::detail {

/// Carries the first answer to the client's strand. It knows the strand, not the port: an answer that comes after
/// the instance has gone finds the strand closed.
class QueryClient::Reply final : public ReplySink, public std::enable_shared_from_this<Reply> {
 public:
  Reply(QueryClient& client, QueryId id)
      : client_(client), id_(id), strand_(client.hull().shared_strand()), wire_(client.full_name() + "/reply") {}

  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) override {
    if (answered_.exchange(true) || abandoned()) return;
    const Object* staged = object.get();
    Answer answer{outcome, std::move(reason), std::move(object)};
    auto end = [self = shared_from_this(), answer = std::move(answer)]() mutable {
      self->client_.on_answer(self->id_, *self, std::move(answer));
    };
    Clock& clock = strand_->clock();
    if (!clock.staging()) {
      strand_->post(std::move(end));
      return;
    }
    clock.stage({wire_, static_cast<std::uint64_t>(id_), staged, to_string(outcome),
                 [strand = strand_, end = std::move(end)]() mutable { strand->post(std::move(end)); }});
  }

 private:
  QueryClient& client_;  ///< touched on its strand only, which is closed before it goes
  const QueryId id_;
  const std::shared_ptr<Strand> strand_;
  const std::string wire_;
  std::atomic<bool> answered_{false};
};

QueryClient::QueryClient(Component& owner, std::string_view name, const ServiceInfo& service,
                         const PortOptions& options)
    : RequiredPort(owner, name, service, options),
      at_rewire_(options.at_rewire),
      request_rules_(service.object()),
      answer_rules_(*service.answer()) {
  if (at_rewire_ != AtRewire::Redirect || service.contract().idempotent()) return;
  throw Error(ErrorCode::Usage,
              {.what = "port '" + std::string(name) + "' asks for its requests to be redirected at a rewire",
               .where = service.name(),
               .expected = "a service whose contract says idempotent: a provider may get the request twice",
               .next = "use AtRewire::Finish or AtRewire::Fail"});
}

QueryClient::~QueryClient() {
  for (auto& [id, open] : open_) {
    if (!open.answer) open.reply->abandon();
  }
}

Outcome QueryClient::put_to_target(QueryId id, Open& open) {
  if (connection() == Connection::Unwired) return Outcome::Unwired;
  const TimePoint now = hull().clock().now();
  open.since = changes();
  open.reply = std::make_shared<Reply>(*this, id);
  Envelope envelope{open.request, static_cast<std::uint64_t>(id), now, open.request->ByteSizeLong()};
  counters().count(now);
  return target_.deliver(Parcel{std::move(envelope), open.reply}).value_or(Outcome::Disconnected);
}

Result<QueryId> QueryClient::ask(std::shared_ptr<const Object> request, Duration within) {
  if (const auto outcome = obstacle()) return {*outcome, reason_for(*outcome)};
  if (open_.size() >= kMaxOpen) {
    return {Outcome::Rejected, "too many requests are open: receive or discard their answers"};
  }
  if (const auto violation = request_rules_.first_violation(*request)) {
    counters().refuse(*violation, hull().clock().now());
    return {Outcome::Rejected, "the request was refused: " + *violation};
  }
  const QueryId id{next_id_++};
  // Entered first: on another thread the answer may be on its way before `deliver` returns.
  Open& open = open_.emplace(id, Open{std::move(request), nullptr, std::nullopt, nullptr, 0}).first->second;
  ++unanswered_;
  const Outcome outcome = put_to_target(id, open);
  if (outcome == Outcome::Ok) {
    Clock& clock = hull().clock();
    open.deadline = clock.schedule(saturating_sum(clock.now(), within), hull().shared_strand(), [this, id] {
      if (open_.contains(id)) end_unanswered(id, Answer{Outcome::Timeout, {}, nullptr});
    });
    return id;
  }
  open_.erase(id);
  --unanswered_;
  return {outcome, reason_for(outcome)};
}

Async<QueryClient::Answer> QueryClient::answer_to(QueryId id, Duration within) {
  const auto call = std::make_shared<Call>();
  const auto found = open_.find(id);
  if (calls_are_cancelled()) {
    calls().finish(call, Outcome::Cancelled);
  } else if (!is_active()) {
    calls().finish(call, Outcome::NotActive);
  } else if (found == open_.end()) {
    calls().finish(call, Outcome::WrongId);
  } else if (found->second.answer) {
    calls().finish(call, Outcome::Ok);
  } else {
    if (const auto earlier = std::exchange(found->second.call, call)) calls().finish(earlier, Outcome::Cancelled);
  }
  CallAwaiter ended(calls(), call, within);
  const Outcome outcome = co_await ended;
  const auto open = open_.find(id);
  if (open != open_.end() && open->second.call == call) open->second.call = nullptr;
  if (outcome != Outcome::Ok || open == open_.end() || !open->second.answer) {
    co_return Answer{outcome == Outcome::Ok ? Outcome::WrongId : outcome, call->reason, nullptr};
  }
  Answer answer = std::move(*open->second.answer);
  open_.erase(open);
  co_return answer;
}

Async<QueryClient::Answer> QueryClient::ask_and_wait(std::shared_ptr<const Object> request, Duration within) {
  const Result<QueryId> id = ask(std::move(request), within);
  if (!id) {
    // By way of the strand's queue, as every other end: who asks again at once leaves room for others.
    const auto call = std::make_shared<Call>();
    calls().finish(call, id.outcome(), id.reason());
    CallAwaiter ended(calls(), call, within);
    co_await ended;
    co_return Answer{id.outcome(), id.reason(), nullptr};
  }
  Answer answer = co_await answer_to(*id, within);
  give_up(*id);  // unless it has been answered
  co_return answer;
}

bool QueryClient::give_up(QueryId id) {
  const auto found = open_.find(id);
  if (found == open_.end()) return false;
  const Open open = std::move(found->second);
  open_.erase(found);
  hull().clock().cancel(open.deadline);
  if (!open.answer) --unanswered_;
  if (!open.answer) open.reply->abandon();
  if (open.call) calls().finish(open.call, Outcome::WrongId);
  return true;
}

void QueryClient::on_answer(QueryId id, const Reply& from, Answer answer) {
  const auto found = open_.find(id);
  // A request that was put to another provider since is no longer the old one's to answer.
  if (found == open_.end() || found->second.reply.get() != &from) return;
  const auto violation = answer.outcome == Outcome::Ok ? answer_rules_.first_violation(*answer.object) : std::nullopt;
  if (violation) answer = Answer{Outcome::Rejected, "the answer was refused: " + *violation, nullptr};
  end(id, std::move(answer));
}

/// Without the provider's answer.
void QueryClient::end_unanswered(QueryId id, Answer answer) {
  const Open& open = open_.at(id);
  if (!open.answer) open.reply->abandon();
  end(id, std::move(answer));
}

void QueryClient::end(QueryId id, Answer answer) {
  Open& open = open_.at(id);
  if (open.answer) return;
  --unanswered_;
  hull().clock().cancel(open.deadline);
  open.answer = std::move(answer);
  if (open.call) calls().finish(open.call, Outcome::Ok);
}

/// What is open since before that change of the connection.
std::vector<QueryId> QueryClient::open_before(std::uint64_t change) const {
  std::vector<QueryId> ids;
  for (const auto& [id, open] : open_) {
    if (!open.answer && open.since < change) ids.push_back(id);
  }
  return ids;
}

void QueryClient::end_all(std::uint64_t change, const std::string& reason) {
  for (const QueryId id : open_before(change)) {
    if (open_.contains(id)) end_unanswered(id, Answer{Outcome::Disconnected, reason, nullptr});
  }
}

/// Puts what is open to the provider that the port is wired to now.
void QueryClient::redirect(std::uint64_t change) {
  for (const QueryId id : open_before(change)) {
    const auto found = open_.find(id);
    if (found == open_.end()) continue;
    found->second.reply->abandon();
    const Outcome outcome = put_to_target(id, found->second);
    if (outcome != Outcome::Ok) end(id, Answer{outcome, reason_for(outcome), nullptr});
  }
}

void QueryClient::on_connection(Connection connection, std::uint64_t change) {
  if (connection == Connection::Waiting) return;
  const bool rewired = std::exchange(was_connected_, connection == Connection::Connected) && was_connected_;
  if (rewired && at_rewire_ == AtRewire::Redirect) return redirect(change);
  if (!was_connected_) return end_all(change, connection_reason());
  if (rewired && at_rewire_ == AtRewire::Fail) end_all(change, "the port was wired to another provider");
}

}  // namespace fiona::detail
