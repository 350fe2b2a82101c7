#include "fiona/query.hpp"

#include <algorithm>

#include "fiona/hull.hpp"

namespace fiona::detail {

/// Carries the first answer to the client's strand. It knows the strand, not the port: an answer that comes after
/// the instance has gone finds the strand closed.
class QueryClient::Reply final : public ReplySink, public std::enable_shared_from_this<Reply> {
 public:
  Reply(QueryClient& client, std::uint64_t id)
      : client_(client), id_(id), strand_(client.hull().shared_strand()), wire_(client.full_name() + "/reply") {}

  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) override {
    if (answered_.exchange(true) || abandoned()) return;
    Answer answer{outcome, std::move(reason), std::move(object)};
    auto finish = [self = shared_from_this(), answer = std::move(answer)]() mutable {
      self->client_.finish(self->id_, std::move(answer));
    };
    Clock& clock = strand_->clock();
    if (!clock.staging()) {
      strand_->post(std::move(finish));
      return;
    }
    clock.stage(wire_, id_, [strand = strand_, finish = std::move(finish)]() mutable { strand->post(std::move(finish)); });
  }

 private:
  QueryClient& client_;  ///< touched on its strand only, which is closed before it goes
  const std::uint64_t id_;
  const std::shared_ptr<Strand> strand_;
  const std::string wire_;
  std::atomic<bool> answered_{false};
};

QueryClient::~QueryClient() {
  for (auto& [id, open] : open_) open.reply->abandon();
}

void QueryClient::set_target(std::shared_ptr<Sink> target) {
  const std::lock_guard lock(target_mutex_);
  target_ = std::move(target);
}

bool QueryClient::Awaiter::await_suspend(std::coroutine_handle<> caller) {
  if (const auto violation = port.request_rules_.first_violation(*request)) {
    port.counters().refused.fetch_add(1, std::memory_order_relaxed);
    answer = Answer{Outcome::Rejected, "the request was refused: " + *violation, nullptr};
    return false;
  }
  const std::uint64_t id = port.next_id_++;
  const Outcome outcome = port.start(id, *this, caller);
  if (outcome == Outcome::Ok) return true;
  answer.outcome = outcome;
  return false;
}

Outcome QueryClient::start(std::uint64_t id, Awaiter& awaiter, std::coroutine_handle<> caller) {
  std::shared_ptr<Sink> target;
  {
    const std::lock_guard lock(target_mutex_);
    target = target_;
  }
  if (!target) return connection() == Connection::Unwired ? Outcome::Unwired : Outcome::Disconnected;
  Clock& clock = hull().clock();
  const TimePoint now = clock.now();
  auto reply = std::make_shared<Reply>(*this, id);
  Envelope envelope{awaiter.request, id, now, awaiter.request->ByteSizeLong()};
  counters().count(now);
  open_.emplace(id, Open{&awaiter, caller, reply, 0});
  const Outcome outcome = target->deliver(Parcel{std::move(envelope), reply});
  if (outcome != Outcome::Ok) {
    open_.erase(id);
    return outcome;
  }
  open_.at(id).deadline = clock.schedule(now + awaiter.deadline, hull().shared_strand(),
                                         [this, id] { finish(id, Answer{Outcome::Timeout, {}, nullptr}); });
  return Outcome::Ok;
}

void QueryClient::finish(std::uint64_t id, Answer answer) {
  const auto found = open_.find(id);
  if (found == open_.end()) return;
  const Open open = found->second;
  open_.erase(found);
  hull().clock().cancel(open.deadline);
  open.reply->abandon();
  const auto violation = answer.outcome == Outcome::Ok ? answer_rules_.first_violation(*answer.object) : std::nullopt;
  if (violation) answer = Answer{Outcome::Rejected, "the answer was refused: " + *violation, nullptr};
  open.awaiter->answer = std::move(answer);
  open.caller.resume();
}

void QueryClient::on_connection(Connection connection) {
  if (connection == Connection::Connected || connection == Connection::Waiting) return;
  std::vector<std::uint64_t> ids;
  for (const auto& [id, open] : open_) ids.push_back(id);
  std::sort(ids.begin(), ids.end());
  for (const std::uint64_t id : ids) finish(id, Answer{Outcome::Disconnected, {}, nullptr});
}

}  // namespace fiona::detail
