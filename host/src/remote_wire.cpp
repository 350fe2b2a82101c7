#include "remote_wire.hpp"

#include <google/protobuf/message.h>

#include <algorithm>

#include "fiona/error.hpp"
#include "fiona/hull.hpp"

namespace fiona::host {
namespace {

/// What a message counts beside its object's bytes.
constexpr std::size_t kFrameCost = 64;

const Object& prototype_of(const google::protobuf::Descriptor& type) {
  return *google::protobuf::MessageFactory::generated_factory()->GetPrototype(&type);
}

}  // namespace

bool is_push(const Port& port) {
  const Pattern pattern = port.service().pattern();
  return pattern == PUSH_NEWEST || pattern == PUSH_TIMED;
}

wire::Frame frame_for(std::uint64_t wire) {
  wire::Frame frame;
  frame.set_wire(wire);
  return frame;
}

bool CreditQueue::offer(Item item, bool drop_oldest, const SendNow& send) {
  if (waiting_.empty() && may_send(item.bytes)) {
    in_flight_ += item.bytes;
    send(item);
    return true;
  }
  const auto full = [&] { return waiting_bytes_ > 0 && waiting_bytes_ + item.bytes > kWireWindow; };
  if (!drop_oldest && full()) return false;
  while (full()) {
    waiting_bytes_ -= waiting_.front().bytes;
    waiting_.pop_front();
    ++dropped_;
  }
  waiting_bytes_ += item.bytes;
  waiting_.push_back(std::move(item));
  return true;
}

void CreditQueue::credit(std::size_t bytes, const SendNow& send) {
  in_flight_ -= std::min(in_flight_, bytes);
  while (!waiting_.empty() && may_send(waiting_.front().bytes)) {
    Item item = std::move(waiting_.front());
    waiting_.pop_front();
    waiting_bytes_ -= item.bytes;
    in_flight_ += item.bytes;
    send(item);
  }
}

/// Sends the answer to a request of the peer's back over the wire.
class RemoteWire::RemoteReply final : public ReplySink {
 public:
  RemoteReply(std::weak_ptr<RemoteWire> wire, std::uint64_t id) : wire_(std::move(wire)), id_(id) {}
  ~RemoteReply() override {
    if (const auto wire = wire_.lock()) wire->forget(id_);
  }

  void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) override {
    if (answered_.exchange(true) || abandoned()) return;
    const auto wire = wire_.lock();
    if (!wire) return;
    wire::Frame frame = frame_for(wire->wire_);
    auto& answer = *frame.mutable_answer();
    answer.set_id(id_);
    answer.set_outcome(static_cast<std::uint32_t>(outcome));
    answer.set_reason(std::move(reason));
    const std::lock_guard lock(wire->mutex_);
    wire->served_.erase(id_);
    if (!wire->cut_) wire->send_frame(frame, object.get());
  }

  Outcome event(Envelope event) override {
    const auto wire = wire_.lock();
    if (answered_ || abandoned() || !wire) return Outcome::Disconnected;
    CreditQueue::Item item;
    item.frame = frame_for(wire->wire_);
    auto& fired = *item.frame.mutable_fired();
    fired.set_id(id_);
    fired.set_sequence(event.sequence);
    fired.set_origin_ns(event.origin.time_since_epoch().count());
    item.object = std::move(event.object);
    item.bytes = event.bytes + kFrameCost;
    const std::lock_guard lock(wire->mutex_);
    if (wire->cut_) return Outcome::Disconnected;
    return wire->credit_.offer(std::move(item), false, wire->sender()) ? Outcome::Ok : Outcome::Rejected;
  }

 private:
  const std::weak_ptr<RemoteWire> wire_;
  const std::uint64_t id_;
  std::atomic<bool> answered_{false};
};

RemoteWire::RemoteWire(LinkSocket& link, std::string peer, std::uint64_t wire, Port& port)
    : link_(link),
      peer_(std::move(peer)),
      wire_(wire),
      port_(port),
      object_rules_(port.service().object()),
      objects_(prototype_of(port.service().object())),
      answer_rules_(port.service().answer() ? std::optional<ObjectRules>(std::in_place, *port.service().answer())
                                            : std::nullopt),
      answers_(prototype_of(port.service().answer() ? *port.service().answer() : port.service().object())),
      admitted_(port.direction() == PortDirection::Provides) {}

void RemoteWire::open(const std::function<std::uint64_t()>& attach) {
  {
    const std::lock_guard lock(mutex_);
    opening_ = true;
  }
  wire::Frame frame = frame_for(wire_);
  frame.mutable_opened()->set_from_sequence(attach());
  const std::lock_guard lock(mutex_);
  send_frame(frame, nullptr);
  opening_ = false;
  for (auto& parcel : std::exchange(early_, {})) deliver_locked(std::move(parcel));
}

CreditQueue::SendNow RemoteWire::sender() {
  return [this](const CreditQueue::Item& item) { send_frame(item.frame, item.object.get()); };
}

Outcome RemoteWire::deliver(Parcel parcel) {
  const std::lock_guard lock(mutex_);
  if (cut_) return Outcome::Disconnected;
  if (opening_) {
    early_.push_back(std::move(parcel));
    return Outcome::Ok;
  }
  return deliver_locked(std::move(parcel));
}

void RemoteWire::lease(bool held, const std::string& reason) {
  wire::Frame frame = frame_for(wire_);
  frame.mutable_lease()->set_held(held);
  frame.mutable_lease()->set_reason(reason);
  const std::lock_guard lock(mutex_);
  if (!cut_) send_frame(frame, nullptr);
}

Outcome RemoteWire::deliver_locked(Parcel parcel) {
  CreditQueue::Item item;
  item.frame.set_wire(wire_);
  item.object = std::move(parcel.envelope.object);
  item.bytes = parcel.envelope.bytes + kFrameCost;
  const auto origin_ns = parcel.envelope.origin.time_since_epoch().count();
  if (parcel.reply) {
    const std::uint64_t id = next_id_++;
    auto& request = *item.frame.mutable_request();
    request.set_id(id);
    request.set_origin_ns(origin_ns);
    request.set_continuous(parcel.continuous);
    parcel.reply->set_on_abandon([weak = weak_from_this(), id] {
      if (const auto wire = weak.lock()) wire->cancel(id);
    });
    open_.emplace(id, std::move(parcel.reply));
    return credit_.offer(std::move(item), false, sender()) ? Outcome::Ok : Outcome::Rejected;
  }
  auto& object = *item.frame.mutable_object();
  object.set_sequence(parcel.envelope.sequence);
  object.set_origin_ns(origin_ns);
  const bool push = is_push(port_);
  const std::uint64_t dropped = credit_.dropped();
  const bool taken = credit_.offer(std::move(item), push, sender());
  port_.counters().dropped.fetch_add(credit_.dropped() - dropped, std::memory_order_relaxed);
  return taken ? Outcome::Ok : Outcome::Rejected;
}

/// The client gave up: the provider is told, so that it need not go on.
void RemoteWire::cancel(std::uint64_t id) {
  std::shared_ptr<ReplySink> given_up;  // let go outside the lock
  {
    const std::lock_guard lock(mutex_);
    const auto open = open_.find(id);
    if (open == open_.end()) return;
    given_up = std::move(open->second);
    open_.erase(open);
    if (cut_) return;
    wire::Frame frame = frame_for(wire_);
    frame.mutable_cancel()->set_id(id);
    send_frame(frame, nullptr);
  }
  if (const auto notice = take_drained()) notice();
}

void RemoteWire::on_frame(const wire::Frame& frame, std::string_view object) {
  {
    const std::lock_guard lock(mutex_);
    if (!admitted_) {
      kept_.emplace_back(frame, object);
      return;
    }
  }
  handle_frame(frame, object);
}

void RemoteWire::admit() {
  // What comes meanwhile is kept behind what is handled here, so that the order stays.
  while (true) {
    std::vector<std::pair<wire::Frame, std::string>> kept;
    {
      const std::lock_guard lock(mutex_);
      kept.swap(kept_);
      admitted_ = kept.empty();
      if (admitted_) return;
    }
    for (const auto& [frame, object] : kept) handle_frame(frame, object);
  }
}

void RemoteWire::drain(std::function<void()> drained) {
  {
    const std::lock_guard lock(mutex_);
    drained_ = std::move(drained);
  }
  if (const auto notice = take_drained()) notice();
}

/// What is to be called, outside the lock, because nothing is open any more.
std::function<void()> RemoteWire::take_drained() {
  const std::lock_guard lock(mutex_);
  return open_.empty() ? std::exchange(drained_, nullptr) : nullptr;
}

void RemoteWire::handle_frame(const wire::Frame& frame, std::string_view object) {
  switch (frame.what_case()) {
    case wire::Frame::kObject:
    case wire::Frame::kRequest: return on_object(frame, object);
    case wire::Frame::kAnswer: return on_answer(frame.answer(), object);
    case wire::Frame::kCredit: {
      const std::lock_guard lock(mutex_);
      if (!cut_) credit_.credit(frame.credit().bytes(), sender());
      return;
    }
    case wire::Frame::kLease: {
      auto* client = dynamic_cast<RequiredPort*>(&port_);
      const std::lock_guard lock(mutex_);
      if (client && !cut_) client->set_lease(frame.lease().held(), frame.lease().reason());
      return;
    }
    case wire::Frame::kFired: return on_fired(frame.fired(), object);
    case wire::Frame::kCancel: {
      std::shared_ptr<ReplySink> given_up;  // let go outside the lock
      const std::lock_guard lock(mutex_);
      const auto served = served_.find(frame.cancel().id());
      if (served == served_.end()) return;
      given_up = served->second.lock();
      served_.erase(served);
      if (given_up) given_up->abandon();
      return;
    }
    default: return;
  }
}

void RemoteWire::forget(std::uint64_t id) {
  const std::lock_guard lock(mutex_);
  served_.erase(id);
}

std::shared_ptr<Object> RemoteWire::parse(ObjectPool& pool, std::string_view object) {
  auto parsed = pool.acquire();
  if (!parsed->ParseFromArray(object.data(), static_cast<int>(object.size()))) return nullptr;
  return parsed;
}

void RemoteWire::on_object(const wire::Frame& frame, std::string_view object) {
  Inbox* inbox = nullptr;
  if (auto* provided = dynamic_cast<ProvidedPort*>(&port_)) inbox = provided->inbox();
  if (auto* required = dynamic_cast<RequiredPort*>(&port_)) inbox = required->inbox();
  const Pattern pattern = port_.service().pattern();
  const bool request = frame.has_request();
  const bool fits = request ? pattern == QUERY || pattern == EVENT || pattern == SEND : pattern != QUERY && pattern != EVENT;
  if (!inbox || !fits) return;
  auto parsed = parse(objects_, object);
  auto refusal = parsed ? object_rules_.first_violation(*parsed) : "the object does not parse";
  Outcome outcome = Outcome::Rejected;
  std::shared_ptr<ReplySink> reply;
  {
    const std::lock_guard lock(mutex_);
    if (cut_) return;
    if (!request) last_sequence_ = frame.object().sequence();
    give_credit(object.size() + kFrameCost);
    if (request) {
      reply = std::make_shared<RemoteReply>(weak_from_this(), frame.request().id());
      served_[frame.request().id()] = reply;
    }
    if (!refusal) {
      const auto origin_ns = request ? frame.request().origin_ns() : frame.object().origin_ns();
      Envelope envelope{std::move(parsed), request ? frame.request().id() : frame.object().sequence(),
                        TimePoint(Duration(origin_ns)), object.size()};
      outcome = inbox->push({std::move(envelope), reply, frame.request().continuous(), 0});
      if (outcome == Outcome::Rejected) refusal = "the provider's queue is full";
    }
  }
  if (outcome == Outcome::Rejected) port_.counters().refused.fetch_add(1, std::memory_order_relaxed);
  // An acknowledged send ends here, as does what was not taken; the rest is the provider's to answer.
  if (reply && (outcome != Outcome::Ok || pattern == SEND)) reply->answer(outcome, refusal.value_or(""), nullptr);
}

void RemoteWire::on_fired(const wire::Fired& fired, std::string_view object) {
  std::shared_ptr<ReplySink> activation;
  {
    const std::lock_guard lock(mutex_);
    if (cut_ || port_.service().pattern() != EVENT) return;
    give_credit(object.size() + kFrameCost);
    const auto open = open_.find(fired.id());
    if (open == open_.end()) return;
    activation = open->second;
  }
  if (fired.sequence() == 0) {
    activation->event({});
    return;
  }
  auto parsed = parse(answers_, object);
  const auto violation = parsed ? answer_rules_->first_violation(*parsed) : "it does not parse";
  if (violation) {
    port_.counters().refused.fetch_add(1, std::memory_order_relaxed);
    return;  // the client sees the gap in the sequence
  }
  const Outcome outcome = activation->event(
      Envelope{std::move(parsed), fired.sequence(), TimePoint(Duration(fired.origin_ns())), object.size()});
  if (outcome == Outcome::Rejected) port_.counters().dropped.fetch_add(1, std::memory_order_relaxed);
}

/// Credit goes back in quarters of the window, so that a stream of small messages does not double its traffic.
void RemoteWire::give_credit(std::size_t bytes) {
  owed_credit_ += bytes;
  if (owed_credit_ < kWireWindow / 4) return;
  wire::Frame frame = frame_for(wire_);
  frame.mutable_credit()->set_bytes(std::exchange(owed_credit_, 0));
  send_frame(frame, nullptr);
}

void RemoteWire::on_answer(const wire::Answer& answer, std::string_view object) {
  std::shared_ptr<ReplySink> reply;
  {
    const std::lock_guard lock(mutex_);
    const auto open = open_.find(answer.id());
    if (cut_ || open == open_.end()) return;
    reply = std::move(open->second);
    open_.erase(open);
  }
  auto outcome = static_cast<Outcome>(std::min<std::uint32_t>(answer.outcome(), static_cast<std::uint32_t>(Outcome::Rejected)));
  std::string reason = answer.reason();
  std::shared_ptr<Object> parsed;
  if (outcome == Outcome::Ok && answer_rules_) {
    parsed = parse(answers_, object);
    const auto violation = parsed ? answer_rules_->first_violation(*parsed) : "it does not parse";
    if (violation) {
      outcome = Outcome::Rejected;
      reason = "the answer was refused: " + *violation;
      parsed = nullptr;
    }
  }
  reply->answer(outcome, std::move(reason), std::move(parsed));
  if (const auto notice = take_drained()) notice();
}

void RemoteWire::cut(const std::string& reason) {
  std::unordered_map<std::uint64_t, std::shared_ptr<ReplySink>> open;
  std::vector<std::shared_ptr<ReplySink>> served;
  {
    const std::lock_guard lock(mutex_);
    cut_ = true;
    drained_ = nullptr;
    kept_.clear();
    open.swap(open_);
    for (auto& [id, weak] : served_) {
      if (auto reply = weak.lock()) served.push_back(std::move(reply));
    }
    served_.clear();
  }
  for (auto& [id, reply] : open) reply->answer(Outcome::Disconnected, reason, nullptr);
  for (auto& reply : served) reply->abandon();
}

}  // namespace fiona::host
