#include "fiona/send.hpp"

#include "fiona/hull.hpp"

namespace fiona::detail {

/// Why it must not be sent; counted.
std::optional<std::string> SendClient::refusal_of(const Object& object) {
  auto violation = rules_.first_violation(object);
  if (violation) counters().refuse(*violation, hull().clock().now());
  return violation;
}

Outcome SendClient::put_to_target(std::shared_ptr<const Object> object, std::shared_ptr<ReplySink> receipt) {
  if (connection() == Connection::Unwired) return Outcome::Unwired;
  Envelope envelope{std::move(object), ++sequence_, hull().clock().now(), 0};
  envelope.bytes = envelope.object->ByteSizeLong();
  counters().count(envelope.origin);
  const Outcome outcome =
      target_.deliver(Parcel{std::move(envelope), std::move(receipt)}).value_or(Outcome::Disconnected);
  if (outcome != Outcome::Ok) counters().dropped.fetch_add(1, std::memory_order_relaxed);
  return outcome;
}

Outcome SendClient::send_object(std::shared_ptr<const Object> object) {
  if (calls_are_cancelled()) return Outcome::Cancelled;
  if (!is_active()) return Outcome::NotActive;
  if (refusal_of(*object)) return Outcome::Rejected;
  return put_to_target(std::move(object), nullptr);
}

/// Tells the client's strand how the provider's hull answered.
class SendClient::Receipt final : public ReplySink, public std::enable_shared_from_this<Receipt> {
 public:
  Receipt(SendClient& client, std::shared_ptr<Call> call, std::uint64_t number)
      : client_(client),
        call_(std::move(call)),
        number_(number),
        strand_(client.hull().shared_strand()),
        wire_(client.full_name() + "/receipt") {}

  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object>) override {
    if (answered_.exchange(true)) return;
    auto end = [self = shared_from_this(), outcome, reason = std::move(reason)] {
      self->client_.calls().finish(self->call_, outcome, reason);
    };
    Clock& clock = strand_->clock();
    if (!clock.staging()) {
      strand_->post(std::move(end));
      return;
    }
    clock.stage({wire_, number_, nullptr, to_string(outcome),
                 [strand = strand_, end = std::move(end)]() mutable { strand->post(std::move(end)); }});
  }

 private:
  SendClient& client_;  ///< touched on its strand only, which is closed before it goes
  const std::shared_ptr<Call> call_;
  const std::uint64_t number_;
  const std::shared_ptr<Strand> strand_;
  const std::string wire_;
  std::atomic<bool> answered_{false};
};

Async<Result<Acknowledged>> SendClient::send_and_wait(std::shared_ptr<const Object> object, Duration within) {
  const auto call = std::make_shared<Call>();
  call->since = changes();
  const auto receipt = std::make_shared<Receipt>(*this, call, sequence_ + 1);
  if (const auto refusal = obstacle()) {
    calls().finish(call, *refusal, reason_for(*refusal));
  } else if (const auto violation = refusal_of(*object)) {
    calls().finish(call, Outcome::Rejected, "the message was refused: " + *violation);
  } else {
    const Outcome put = put_to_target(std::move(object), receipt);
    if (put != Outcome::Ok) calls().finish(call, put, reason_for(put));
  }
  CallAwaiter ended(calls(), call, within);
  const Outcome outcome = co_await ended;
  if (outcome == Outcome::Ok) co_return Acknowledged{};
  receipt->abandon();
  co_return Result<Acknowledged>(outcome, call->reason);
}

void SendClient::on_connection(Connection connection, std::uint64_t change) {
  if (connection == Connection::Unwired || connection == Connection::Lost) {
    calls().finish_all(Outcome::Disconnected, connection_reason(), change);
  }
}

}  // namespace fiona::detail
