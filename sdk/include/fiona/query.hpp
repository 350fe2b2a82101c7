#pragma once

#include <atomic>
#include <coroutine>
#include <exception>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "fiona/error.hpp"
#include "fiona/port.hpp"
#include "fiona/provides.hpp"
#include "fiona/rules.hpp"

namespace fiona {

/// Names an open request of one client port.
enum class QueryId : std::uint64_t {};

namespace detail {

class QueryClient : public RequiredPort {
 public:
  /// Requests that may be open at once; answers that nobody receives count.
  static constexpr std::size_t kMaxOpen = 4096;

  QueryClient(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options);
  ~QueryClient() override;
  std::size_t redirectable() const override { return at_rewire_ == AtRewire::Redirect ? unanswered_.load() : 0; }

 protected:
  void use_target(std::shared_ptr<Sink> target) override { target_.set(std::move(target)); }
  struct Answer {
    Outcome outcome = Outcome::NoData;
    std::string reason;
    std::shared_ptr<const Object> object;
  };
  Result<QueryId> ask(std::shared_ptr<const Object> request, Duration within);
  Async<Answer> answer_to(QueryId id, Duration within);
  Async<Answer> ask_and_wait(std::shared_ptr<const Object> request, Duration within);
  bool give_up(QueryId id);

  void on_connection(Connection connection, std::uint64_t change) override;

 private:
  class Reply;
  struct Open {
    std::shared_ptr<const Object> request;
    std::shared_ptr<Reply> reply;
    std::optional<Answer> answer;
    std::shared_ptr<Call> call;  ///< of who waits for it
    TimerId deadline = 0;
    std::uint64_t since = 0;  ///< `changes` when it was put
  };
  Outcome put_to_target(QueryId id, Open& open);
  void on_answer(QueryId id, const Reply& from, Answer answer);
  void end(QueryId id, Answer answer);
  void end_unanswered(QueryId id, Answer answer);
  std::vector<QueryId> open_before(std::uint64_t change) const;
  void end_all(std::uint64_t change, const std::string& reason);
  void redirect(std::uint64_t change);

  const AtRewire at_rewire_;
  Target target_;
  std::map<QueryId, Open> open_;  ///< strand only
  std::atomic<std::size_t> unanswered_{0};
  std::uint64_t next_id_ = 1;
  bool was_connected_ = false;
  const ObjectRules request_rules_;
  const ObjectRules answer_rules_;
};

class QueryProvider : public ProvidedPort {
 public:
  QueryProvider(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options,
                Inbox::Handler handler)
      : ProvidedPort(owner, name, service, options), inbox_(*this, Delivery::Each, std::move(handler)) {}
  Inbox* inbox() override { return &inbox_; }

 private:
  Inbox inbox_;
};

}  // namespace detail

/// The right, and the duty, to answer one request; movable, may be kept and used later on the strand. Dropped without
/// an answer it answers `rejected("no answer")`, or that the handler has failed.
template <class A>
class Reply {
 public:
  explicit Reply(std::shared_ptr<ReplySink> sink) : sink_(std::move(sink)) {}
  Reply(Reply&&) noexcept = default;
  Reply& operator=(Reply&& other) noexcept {
    std::swap(sink_, other.sink_);
    return *this;
  }
  ~Reply() {
    const bool throws = std::uncaught_exceptions() > 0;
    if (sink_ && !(throws && sink_->in_handler())) {
      sink_->answer(Outcome::Rejected, throws ? kFailed : "no answer", nullptr);
    }
  }

  /// [any thread] Ends the request with this answer.
  void answer(A object) { answer(std::make_shared<const A>(std::move(object))); }
  void answer(std::shared_ptr<const A> object) { end(Outcome::Ok, {}, std::move(object)); }
  /// [any thread] Ends it without one; the client's result carries `reason`.
  void reject(std::string reason) { end(Outcome::Rejected, std::move(reason), nullptr); }
  /// [any thread] Whether the client gave up, or is gone: an answer would reach nobody.
  bool abandoned() const { return !sink_ || sink_->abandoned(); }

  static constexpr const char* kFailed = "the provider failed while it handled this";

 private:
  void end(Outcome outcome, std::string reason, std::shared_ptr<const A> object) {
    if (auto sink = std::exchange(sink_, nullptr)) sink->answer(outcome, std::move(reason), std::move(object));
  }
  std::shared_ptr<ReplySink> sink_;
};

namespace detail {

template <class A>
Async<> answer_later(Async<A> work, Reply<A> reply) {
  try {
    reply.answer(co_await work);
  } catch (const Error& error) {
    reply.reject(error.what());
  } catch (...) {
    reply.reject(Reply<A>::kFailed);
    throw;
  }
}

/// A handler that takes a Reply, which it may have dropped, used or kept when it throws.
template <class A, class F>
void reply_by(const F& handler, const std::shared_ptr<ReplySink>& sink) {
  sink->set_in_handler(true);
  try {
    handler(Reply<A>(sink));
  } catch (const Error& error) {
    return sink->answer(Outcome::Rejected, error.what(), nullptr);
  } catch (...) {
    sink->answer(Outcome::Rejected, Reply<A>::kFailed, nullptr);
    throw;
  }
  sink->set_in_handler(false);
}

/// `A f(const Q&)`, `Async<A> f(const Q&)` or `void f(const Q&, Reply<A>)`; each may be const.
template <class Q, class A, class C, class H>
Inbox::Handler query_handler(C& owner, H handler) {
  return [&owner, handler](const Parcel& parcel) -> std::optional<Async<>> {
    const auto& request = static_cast<const Q&>(*parcel.envelope.object);
    if constexpr (std::is_invocable_v<H, C&, const Q&, Reply<A>>) {
      static_assert(std::is_void_v<std::invoke_result_t<H, C&, const Q&, Reply<A>>>,
                    "a query handler that takes a fiona::Reply returns void");
      reply_by<A>([&](Reply<A> reply) { (owner.*handler)(request, std::move(reply)); }, parcel.reply);
      return std::nullopt;
    } else {
      using R = std::invoke_result_t<H, C&, const Q&>;
      Reply<A> reply(parcel.reply);
      if constexpr (std::is_same_v<R, A>) {
        try {
          reply.answer((owner.*handler)(request));
        } catch (const Error& error) {
          reply.reject(error.what());
        }
        return std::nullopt;
      } else {
        static_assert(std::is_same_v<R, Async<A>>, "a query handler returns the answer or fiona::Async of it");
        return answer_later<A>((owner.*handler)(request), std::move(reply));
      }
    }
  };
}

}  // namespace detail

/// Answers requests: `Provides<RouteService> routes_{*this, "routes", &Self::on_route};`. The handler returns the
/// answer, returns an Async of it, or takes a `Reply` to be used later. A handler that throws Error rejects the
/// request with its text; one that throws anything else fails the instance.
template <QueryService S>
class Provides<S> : public detail::QueryProvider {
 public:
  using RequestType = typename S::RequestType;
  using AnswerType = typename S::AnswerType;

  template <class C, class H>
  Provides(C& owner, std::string_view name, H handler, PortOptions options = {})
      : QueryProvider(owner, name, S::info(), options, detail::query_handler<RequestType, AnswerType>(owner, handler)) {
  }
};

/// Asks: `auto route = co_await routes_.query(request, 500ms);`
template <QueryService S>
class Requires<S> : public detail::QueryClient {
 public:
  using RequestType = typename S::RequestType;
  using AnswerType = typename S::AnswerType;
  using AnswerPtr = std::shared_ptr<const AnswerType>;

  template <class C>
  Requires(C& owner, std::string_view name, PortOptions options = {}) : QueryClient(owner, name, S::info(), options) {}

  /// [strand] Exactly one outcome: the answer, or why there is none, within the deadline. Many may be open at once;
  /// answers come in any order. The answer is shared with the provider and immutable.
  Async<Result<AnswerPtr>> query(RequestType request, Duration deadline = kDefaultDeadline) {
    co_return result(co_await ask_and_wait(std::make_shared<const RequestType>(std::move(request)), deadline));
  }

  /// [strand] The same in two steps. The id stays valid, until it is received or discarded, through a wait that times
  /// out or is cancelled; a second wait for it ends the first with Cancelled. Not answered by `deadline`, the request
  /// ends with Timeout, which is then what is received.
  Result<QueryId> request(RequestType request, Duration deadline = kDefaultDeadline) {
    return ask(std::make_shared<const RequestType>(std::move(request)), deadline);
  }
  Async<Result<AnswerPtr>> receive(QueryId id, Duration deadline = kDefaultDeadline) {
    co_return result(co_await answer_to(id, deadline));
  }
  /// [strand] Gives the request up and tells the provider; WrongId if it is not open.
  Outcome discard(QueryId id) { return give_up(id) ? Outcome::Ok : Outcome::WrongId; }

 private:
  static Result<AnswerPtr> result(Answer answer) {
    if (answer.outcome != Outcome::Ok) return {answer.outcome, std::move(answer.reason)};
    return std::static_pointer_cast<const AnswerType>(answer.object);
  }
};

}  // namespace fiona
