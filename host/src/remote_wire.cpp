#include "remote_wire.hpp"

#include <google/protobuf/message.h>

#include <algorithm>

#include "clock_offset.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"

namespace fiona::host {
namespace {

/// Messages that wait for others which came with them.
constexpr std::size_t kMostTogether = 64;
constexpr const char* kAnswerTooLarge = "the answer is larger than a link carries (64 MiB)";
constexpr const char* kFull = "the answers before it have not been taken yet";
constexpr const char* kIdInUse = "a request has the id of one that is still open";
/// Sends that wait for room, of one wire, or of all that have ended.
constexpr std::size_t kMostHeld = 2 * kLaneWindow;

std::atomic<std::size_t> held_of_ended{0};  // bytes, of this process

const Object& prototype_of(const google::protobuf::Descriptor& type) {
  return *google::protobuf::MessageFactory::generated_factory()->GetPrototype(&type);
}

}  // namespace

wire::Frame frame_for(std::uint64_t wire) {
  wire::Frame frame;
  frame.set_wire(wire);
  return frame;
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
    answer.set_reason(told_reason(reason));
    const std::lock_guard lock(wire->mutex_);
    wire->served_.erase(id_);
    if (!wire->cut_) send(*wire, frame, object);
  }

  Outcome event(Envelope event) override {
    const auto wire = wire_.lock();
    if (answered_ || abandoned() || !wire) return Outcome::Disconnected;
    wire::Frame frame = frame_for(wire->wire_);
    auto& fired = *frame.mutable_fired();
    fired.set_id(id_);
    fired.set_sequence(event.sequence);
    fired.set_origin_ns(event.origin.time_since_epoch().count());
    const auto rule = event.object ? LinkSocket::Rule::MustFit : LinkSocket::Rule::Control;
    const std::lock_guard lock(wire->mutex_);
    if (wire->cut_) return Outcome::Disconnected;
    return wire->outcome_of(wire->link_->send(wire->lane_, frame, event.object, rule));
  }

 private:
  /// An answer that does not fit is refused with the reason in its place: the client does not wait for its deadline.
  static void send(RemoteWire& wire, wire::Frame& frame, const std::shared_ptr<const Object>& object) {
    if (!object) return wire.send_frame(frame);
    const auto sent = wire.link_->send(wire.lane_, frame, object, LinkSocket::Rule::MustFit);
    if (wire.outcome_of(sent) == Outcome::Ok) return;
    frame.clear_lane();
    frame.clear_size();
    frame.mutable_answer()->set_outcome(static_cast<std::uint32_t>(Outcome::Rejected));
    frame.mutable_answer()->set_reason(sent.what == LinkSocket::Sent::What::TooLarge ? kAnswerTooLarge : kFull);
    wire.send_frame(frame);
  }

  const std::weak_ptr<RemoteWire> wire_;
  const std::uint64_t id_;
  std::atomic<bool> answered_{false};
};

RemoteWire::RemoteWire(std::shared_ptr<LinkSocket> link, std::string peer, std::uint64_t wire, Port& port,
                       std::string name, std::shared_ptr<WireEnd> end)
    : RemoteWire(nullptr, std::move(link), std::move(peer), wire, port, std::move(name), std::move(end)) {}

RemoteWire::RemoteWire(std::shared_ptr<FanOut> fan_out, std::shared_ptr<LinkSocket> link, std::string peer,
                       std::uint64_t wire, Port& port, std::string name, std::shared_ptr<WireEnd> end)
    : link_(std::move(link)),
      peer_(std::move(peer)),
      wire_(wire),
      port_(port),
      name_(std::move(name)),
      clock_(port.hull().clock()),
      room_name_(name_ + "/room"),
      fan_out_(std::move(fan_out)),
      lane_(fan_out_ ? fan_out_->lane() : link_->open_lane(peer_)),
      inbox_(port.inbox()),
      end_(std::move(end)),
      object_rules_(port.service().object()),
      objects_(prototype_of(port.service().object())),
      answer_rules_(port.service().answer() ? std::optional<ObjectRules>(std::in_place, *port.service().answer())
                                            : std::nullopt),
      answers_(prototype_of(port.service().answer() ? *port.service().answer() : port.service().object())),
      admitted_(port.direction() == PortDirection::Provides || !port.service().is_push()) {}

RemoteWire::~RemoteWire() {
  if (cut_) held_of_ended -= held_bytes_;
}

void RemoteWire::ask(const std::string& token, bool ahead) {
  wire::Frame frame = frame_for(wire_);
  frame.mutable_open()->set_version(wire::VERSION_1);
  frame.mutable_open()->set_token(token);
  frame.mutable_open()->set_each(end_ && inbox_->receives_each());
  frame.mutable_open()->set_ahead(ahead);
  send_frame(frame);
}

void RemoteWire::open(std::uint32_t prescale, bool each) {
  prescale_ = prescale;
  each_ = each;
  if (!fan_out_) return attached(0, Duration::zero());
  dynamic_cast<detail::PushProvider&>(port_).attach(fan_out_, *this);
}

void RemoteWire::attached(std::uint64_t sequence, Duration cycle) {
  wire::Frame frame = frame_for(wire_);
  frame.mutable_opened()->set_from_sequence(sequence);
  frame.mutable_opened()->set_cycle_ns(cycle.count());
  send_frame(frame);
  if (fan_out_) fan_out_->join(wire_, sequence, prescale_, each_);
}

Outcome RemoteWire::deliver(Parcel parcel) {
  if (fan_out_) return fan_out_->deliver_to(wire_, parcel);
  if (parcel.reply && link_->refuses(parcel.envelope.object->ByteSizeLong())) {
    port_.counters().refuse(LinkSocket::kTooLarge, clock_.now());
    parcel.reply->answer(Outcome::Rejected, LinkSocket::kTooLarge, nullptr);
    return Outcome::Ok;
  }
  const std::lock_guard lock(mutex_);
  if (cut_ || drains_) return Outcome::Disconnected;
  return deliver_locked(std::move(parcel));
}

void RemoteWire::lease(bool held, const std::string& reason) {
  wire::Frame frame = frame_for(wire_);
  frame.mutable_lease()->set_held(held);
  frame.mutable_lease()->set_reason(told_reason(reason));
  const std::lock_guard lock(mutex_);
  if (!cut_) send_frame(frame);
}

/// What becomes of a message that the link does not take; counted where it is too large for any link.
Outcome RemoteWire::outcome_of(const LinkSocket::Sent& sent) {
  if (sent.what == LinkSocket::Sent::What::Ok) return Outcome::Ok;
  if (sent.what == LinkSocket::Sent::What::Gone) return Outcome::Disconnected;
  if (sent.what == LinkSocket::Sent::What::TooLarge) port_.counters().refuse(LinkSocket::kTooLarge, clock_.now());
  return Outcome::Rejected;
}

Outcome RemoteWire::deliver_locked(Parcel parcel) {
  wire::Frame frame = frame_for(wire_);
  if (parcel.reply) return request_locked(frame, std::move(parcel));
  frame.mutable_object()->set_sequence(parcel.envelope.sequence);
  frame.mutable_object()->set_origin_ns(parcel.envelope.origin.time_since_epoch().count());
  return outcome_of(link_->send(lane_, frame, parcel.envelope.object, LinkSocket::Rule::MustFit));
}

Outcome RemoteWire::request_locked(wire::Frame& frame, Parcel parcel) {
  const std::uint64_t id = next_id_++;
  auto& request = *frame.mutable_request();
  request.set_id(id);
  request.set_origin_ns(parcel.envelope.origin.time_since_epoch().count());
  request.set_continuous(parcel.continuous);
  const auto give_up = [weak = weak_from_this(), id] {
    if (const auto wire = weak.lock()) wire->cancel(id);
  };
  parcel.reply->set_on_abandon(give_up, clock_.staging());
  open_.emplace(id, std::move(parcel.reply));
  const Outcome outcome = outcome_of(link_->send(lane_, frame, parcel.envelope.object, LinkSocket::Rule::MustFit));
  if (outcome != Outcome::Ok) open_.erase(id);
  return outcome;
}

/// The client gave up: the provider is told, so that it need not go on. In virtual time an answer that is on its way
/// still comes, as within a process: the request stays open until the provider has confirmed.
void RemoteWire::cancel(std::uint64_t id) {
  wire::Frame frame = frame_for(wire_);
  frame.mutable_cancel()->set_id(id);
  if (clock_.staging()) {
    const std::lock_guard lock(mutex_);
    if (!cut_) send_frame(frame);
    return;
  }
  std::shared_ptr<ReplySink> given_up;  // let go outside the lock
  {
    const std::lock_guard lock(mutex_);
    const auto open = open_.find(id);
    if (open == open_.end()) return;
    given_up = std::move(open->second);
    open_.erase(open);
    if (cut_) return;
    send_frame(frame);
  }
  if (const auto notice = take_drained()) notice();
}

void RemoteWire::on_frame(const wire::Frame& frame, const ObjectBytes& object) {
  if (frame.has_object() || frame.has_request()) return on_object(frame, parse_object(object));
  if (!keep(frame, {})) handle_frame(frame, object);
}

ParsedObject RemoteWire::parse_object(const ObjectBytes& bytes) {
  auto object = objects_.acquire();
  if (!bytes.parse_into(*object)) return {nullptr, "the object does not parse", bytes.size()};
  auto refusal = object_rules_.first_violation(*object);
  return {std::move(object), std::move(refusal), bytes.size()};
}

void RemoteWire::on_object(const wire::Frame& frame, const ParsedObject& object) {
  if (!keep(frame, object)) handle_object(frame, object);
}

/// Keeps what comes of a push before `admit`. Of its objects the oldest are lost beyond what a lane holds, as they
/// would be in any other queue; of a lease, and of a question for room, which is not put again, the last one stays.
bool RemoteWire::keep(const wire::Frame& frame, const ParsedObject& object) {
  if (admitted_) return false;
  const std::lock_guard lock(mutex_);
  if (admitted_ || cut_) return false;
  if (frame.has_lost()) return false;  // which is counted at once
  if (!frame.has_object() && !frame.has_lease() && !frame.has_room()) return true;
  if (frame.has_object()) {
    make_room_in_kept(object.bytes + kFrameCost);
  } else {
    std::erase_if(kept_, [&](const Kept& one) { return one.frame.what_case() == frame.what_case(); });
  }
  kept_.push_back({frame, object});
  return true;
}

/// Called with the lock held.
void RemoteWire::make_room_in_kept(std::size_t cost) {
  for (auto it = kept_.begin(); it != kept_.end() && kept_bytes_ + cost > kLaneWindow;) {
    if (!it->frame.has_object()) {
      ++it;
      continue;
    }
    kept_bytes_ -= it->object.bytes + kFrameCost;
    port_.counters().dropped.fetch_add(1, std::memory_order_relaxed);
    it = kept_.erase(it);
  }
  kept_bytes_ += cost;
}

void RemoteWire::admit() {
  // What comes meanwhile is kept behind what is handled here, so that the order stays.
  while (true) {
    std::deque<Kept> kept;
    {
      const std::lock_guard lock(mutex_);
      kept.swap(kept_);
      kept_bytes_ = 0;
      admitted_ = kept.empty();
      if (admitted_) return;
    }
    for (const auto& [frame, object] : kept) {
      frame.has_object() ? handle_object(frame, object) : handle_frame(frame, {});
    }
  }
}

void RemoteWire::drain(std::function<void()> drained) {
  {
    const std::lock_guard lock(mutex_);
    drains_ = true;
    drained_ = std::move(drained);
  }
  if (const auto notice = take_drained()) notice();
}

/// What is to be called, outside the lock, because nothing is open any more.
std::function<void()> RemoteWire::take_drained() {
  const std::lock_guard lock(mutex_);
  return open_.empty() ? std::exchange(drained_, nullptr) : nullptr;
}

void RemoteWire::handle_frame(const wire::Frame& frame, const ObjectBytes& object) {
  switch (frame.what_case()) {
    case wire::Frame::kAnswer: return on_answer(frame.answer(), object);
    case wire::Frame::kLease: {
      const bool held = frame.lease().held();
      if (!end_) return;  // of a push alone
      return take_in_turn(nullptr, held ? kSpeaks : kSilent,
                          [self = shared_from_this(), held, reason = told_reason(frame.lease().reason())] {
                            const std::lock_guard lock(self->mutex_);
                            if (self->cut_ || self->passed_over_) return;
                            self->end_->set_lease(held, reason);
                          });
    }
    case wire::Frame::kLost:
      // Of its provider, or of a host on the way, which tells both ends. Who has asked is told otherwise.
      if (port_.service().pattern() != QUERY) note_lost(frame.lost().messages());
      return;
    case wire::Frame::kFired: return on_fired(frame.fired(), object);
    case wire::Frame::kRoom: return on_room(frame.room().bytes());
    case wire::Frame::kCancel: return on_cancel(frame.cancel().id());
    default: return;
  }
}

/// Of what comes from outside no more counts than there can be: of a push what was put, for each wire that shares it.
void RemoteWire::note_lost(std::uint64_t messages) {
  constexpr std::uint64_t kMost = 1ULL << 32U;
  auto& counters = port_.counters();
  const std::uint64_t wires = fan_out_ ? std::max<std::size_t>(fan_out_->subscribers(), 1) : 1;
  const std::uint64_t most = fan_out_ ? wires * counters.messages.load(std::memory_order_relaxed) : kMost;
  const std::lock_guard lock(mutex_);
  const std::uint64_t more = std::min(messages, most - std::min(most, told_lost_));
  told_lost_ += more;
  counters.dropped.fetch_add(more, std::memory_order_relaxed);
}

void RemoteWire::take_in_turn(const Object* object, std::string_view word, Job job) {
  if (!clock_.staging()) return job();
  clock_.stage({name_, ++staged_, object, word, std::move(job)});
}

void RemoteWire::on_objects(std::vector<Parcel>& parcels) {
  const std::lock_guard lock(mutex_);
  if (cut_ || passed_over_) {
    cut_ ? link_->count_late(parcels.size()) : count_passed_over(parcels.size());
    return parcels.clear();
  }
  last_sequence_ = parcels.back().envelope.sequence;
  end_->push_all(parcels);
}

bool ArrivingObjects::begin(const std::shared_ptr<RemoteWire>& wire, InUse& use, const wire::Frame& frame,
                            const ObjectBytes& object) {
  if (!frame.has_object() || !wire->takes_many()) return false;
  use_.emplace(use);
  wire_ = wire;
  return take(frame, object);
}

bool ArrivingObjects::take(const wire::Frame& frame, const ObjectBytes& object) {
  if (!wire_ || frame.wire() != wire_->wire() || !frame.has_object() || !frame.also().empty()) return false;
  ParsedObject parsed = wire_->parse_object(object);
  if (parsed.refusal) {
    pass_on();
    wire_->on_object(frame, parsed);
    return true;
  }
  parcels_.push_back({{std::move(parsed.object), frame.object().sequence(),
                       TimePoint(Duration(told_ns(frame.object().origin_ns()))), parsed.bytes},
                      nullptr});
  if (parcels_.size() == kMostTogether) pass_on();
  return true;
}

void ArrivingObjects::pass_on() {
  if (!parcels_.empty()) wire_->on_objects(parcels_);
}

void ArrivingObjects::settle() {
  if (!wire_) return;
  pass_on();
  wire_.reset();
  use_.reset();
}

/// From the provider: it asks. From the client: it answers.
void RemoteWire::on_room(std::size_t bytes) {
  if (!fan_out_) {
    if (!end_) return;
    return take_in_turn(nullptr, kAsksRoom, [self = shared_from_this(), bytes] { self->answer_room(bytes); });
  }
  if (!clock_.staging()) return fan_out_->on_room(wire_, bytes);
  clock_.stage({room_name_, ++rooms_staged_, nullptr, kHasRoom,
                [self = shared_from_this(), bytes] { self->fan_out_->on_room(self->wire_, bytes); }});
}

void RemoteWire::answer_room(std::size_t cost) {
  std::optional<std::size_t> room;
  {
    const std::lock_guard lock(mutex_);
    if (cut_) return;
    room = end_->room(cost, weak_from_this(), [weak = weak_from_this()](std::size_t now) {
      if (const auto self = weak.lock()) self->tell_room(now);
    });
  }
  if (room) tell_room(*room);
}

void RemoteWire::tell_room(std::size_t room) {
  wire::Frame frame = frame_for(wire_);
  frame.mutable_room()->set_bytes(room);
  const std::lock_guard lock(mutex_);
  if (!cut_) send_frame(frame);
}

/// From the client: it gave up. From the provider: it knows that we did.
void RemoteWire::on_cancel(std::uint64_t id) {
  if (port_.direction() == PortDirection::Provides) {
    return take_in_turn(nullptr, kGivenUp, [self = shared_from_this(), id] { self->on_given_up(id); });
  }
  std::shared_ptr<ReplySink> given_up;  // let go outside the lock
  {
    const std::lock_guard lock(mutex_);
    const auto open = open_.find(id);
    if (open == open_.end() || !open->second->given_up()) return;
    given_up = std::move(open->second);
    open_.erase(open);
  }
  if (const auto notice = take_drained()) notice();
}

void RemoteWire::on_given_up(std::uint64_t id) {
  std::shared_ptr<ReplySink> given_up;  // let go outside the lock
  const std::lock_guard lock(mutex_);
  if (clock_.staging() && !cut_) {
    wire::Frame confirmed = frame_for(wire_);
    confirmed.mutable_cancel()->set_id(id);
    send_frame(confirmed);
  }
  const auto served = served_.find(id);
  if (served == served_.end()) return;
  given_up = served->second.lock();
  served_.erase(served);
  if (given_up) given_up->abandon();
}

void RemoteWire::forget(std::uint64_t id) {
  const std::lock_guard lock(mutex_);
  served_.erase(id);
}

void RemoteWire::handle_object(const wire::Frame& frame, const ParsedObject& object) {
  const Pattern pattern = port_.service().pattern();
  const bool request = frame.has_request();
  const bool fits =
      request ? pattern == QUERY || pattern == EVENT || pattern == SEND : pattern != QUERY && pattern != EVENT;
  if (!inbox_ || !fits) return;
  if (!clock_.staging()) return take(frame, object);
  take_in_turn(object.object.get(), to_string(Outcome::Rejected),
               [self = shared_from_this(), frame, object] { self->take(frame, object); });
}

void RemoteWire::take(const wire::Frame& frame, const ParsedObject& object) {
  const bool request = frame.has_request();
  std::string refusal = object.refusal.value_or("");
  Outcome outcome = Outcome::Rejected;
  std::shared_ptr<ReplySink> reply;
  bool acknowledged = false;
  bool waits = false;
  {
    const std::lock_guard lock(mutex_);
    if (cut_) {  // the port may have gone since
      if (!request) link_->count_late(1);
      return;
    }
    if (passed_over_) return count_passed_over(1);
    if (!request) last_sequence_ = frame.object().sequence();
    if (request) {
      const auto [served, is_new] = served_.try_emplace(frame.request().id());
      if (!is_new) return port_.counters().refuse(kIdInUse, clock_.now());  // an answer would be taken for the other's
      reply = std::make_shared<RemoteReply>(weak_from_this(), frame.request().id());
      served->second = reply;
    }
    if (!object.refusal) {
      const auto origin_ns = request ? frame.request().origin_ns() : frame.object().origin_ns();
      Envelope envelope{object.object, request ? frame.request().id() : frame.object().sequence(),
                        TimePoint(Duration(told_ns(origin_ns))), object.bytes};
      Parcel parcel{std::move(envelope), reply, frame.request().continuous(), 0};
      const bool may_wait = port_.service().pattern() == SEND && !clock_.staging();
      const auto taken = may_wait ? take_or_hold(std::move(parcel))
                         : end_   ? end_->push(std::move(parcel))
                                  : inbox_->push(std::move(parcel));
      waits = !taken;
      outcome = taken.value_or(Outcome::Ok);
      if (outcome == Outcome::Rejected) refusal = Inbox::kFull;
    }
    if (outcome == Outcome::Rejected) port_.counters().refuse(refusal, clock_.now());
    acknowledged = port_.service().pattern() == SEND && !waits;
  }
  // An acknowledged send ends here, as does what was not taken; the rest is the provider's to answer.
  const bool ends = outcome != Outcome::Ok || acknowledged;
  if (reply && ends) reply->answer(outcome, std::move(refusal), nullptr);
}

/// What its sender was told is taken waits where the queue is full, and costs him his credit meanwhile: so he is told
/// of what comes after it, and that waits behind it. Of one who sends without credit it is refused. None: it waits.
/// Called with the lock held.
std::optional<Outcome> RemoteWire::take_or_hold(Parcel parcel) {
  const bool is_first = held_.empty();
  if (is_first) {
    const Outcome outcome = inbox_->push(parcel);
    if (outcome != Outcome::Rejected || parcel.reply) return outcome;
  }
  if (held_bytes_ > kMostHeld) return Outcome::Rejected;
  held_bytes_ += Inbox::cost_of(parcel.envelope.bytes);
  held_.push_back({std::move(parcel), link_->receipt()});
  // For others room is waited for already.
  if (is_first && has_room_for_held()) port_.hull().strand().post([self = shared_from_this()] { self->take_held(); });
  return std::nullopt;
}

/// For the first of them; false: `take_held` is called once there is, though the wire may have ended by then. Called
/// with the lock held.
bool RemoteWire::has_room_for_held() {
  const auto taken = [self = shared_from_this()](std::size_t) { self->take_held(); };
  return inbox_->room(Inbox::cost_of(held_.front().parcel.envelope.bytes), weak_from_this(), taken).has_value();
}

void RemoteWire::take_held() {
  std::vector<std::pair<Held, Outcome>> taken;  // answered, and let go of, outside the lock: the link is told
  {
    const std::lock_guard lock(mutex_);
    while (!held_.empty()) {
      Held& first = held_.front();
      const bool given_up = first.parcel.reply && first.parcel.reply->abandoned();
      const Outcome outcome = given_up ? Outcome::Cancelled : inbox_->push(first.parcel);
      if (outcome == Outcome::Rejected) {
        if (!has_room_for_held()) break;
        continue;  // there is by now
      }
      const std::size_t bytes = Inbox::cost_of(first.parcel.envelope.bytes);
      held_bytes_ -= bytes;
      if (cut_) held_of_ended -= bytes;
      taken.emplace_back(std::move(first), outcome);
      held_.pop_front();
    }
  }
  for (const auto& [held, outcome] : taken) {
    if (held.parcel.reply) held.parcel.reply->answer(outcome, {}, nullptr);
  }
}

/// The wire has ended. Its sender was told that they are taken: they still go, as far as wires that have ended keep no
/// more than one may. Called with the lock held.
std::deque<RemoteWire::Held> RemoteWire::end_held() {
  if (held_of_ended == 0 || held_of_ended + held_bytes_ <= kMostHeld) {
    held_of_ended += held_bytes_;
    return {};
  }
  held_bytes_ = 0;
  for (const Held& one : held_) {
    if (!one.parcel.reply) port_.counters().refuse("its wire has ended before there was room", clock_.now());
  }
  return std::exchange(held_, {});
}

void RemoteWire::on_fired(const wire::Fired& fired, const ObjectBytes& object) {
  std::shared_ptr<ReplySink> activation;
  {
    const std::lock_guard lock(mutex_);
    if (cut_ && fired.sequence() > 0) link_->count_late(1);
    if (cut_ || port_.service().pattern() != EVENT) return;
    const auto open = open_.find(fired.id());
    if (open == open_.end()) return fired.sequence() > 0 ? link_->count_late(1) : void();
    activation = open->second;
  }
  if (fired.sequence() == 0) {
    activation->event({});
    return;
  }
  auto parsed = answers_.acquire();
  const auto violation = object.parse_into(*parsed) ? answer_rules_->first_violation(*parsed) : "it does not parse";
  if (violation) {
    port_.counters().refuse(*violation, clock_.now());
    parsed = nullptr;
  }
  const auto outcome = activation->event(
      Envelope{std::move(parsed), fired.sequence(), TimePoint(Duration(told_ns(fired.origin_ns()))), object.size()});
  if (outcome == Outcome::Disconnected) link_->count_late(1);
}

void RemoteWire::on_answer(const wire::Answer& answer, const ObjectBytes& object) {
  std::shared_ptr<ReplySink> reply;
  {
    const std::lock_guard lock(mutex_);
    const auto open = open_.find(answer.id());
    if (cut_ || open == open_.end()) return;
    reply = std::move(open->second);
    open_.erase(open);
  }
  auto outcome =
      static_cast<Outcome>(std::min<std::uint32_t>(answer.outcome(), static_cast<std::uint32_t>(Outcome::Rejected)));
  std::string reason = told_reason(answer.reason());
  std::shared_ptr<Object> parsed;
  if (outcome == Outcome::Ok && answer_rules_) {
    parsed = answers_.acquire();
    const auto violation = object.parse_into(*parsed) ? answer_rules_->first_violation(*parsed) : "it does not parse";
    if (violation) {
      outcome = Outcome::Rejected;
      reason = "the answer was refused: " + *violation;
      parsed = nullptr;
    }
  }
  reply->answer(outcome, std::move(reason), std::move(parsed));
  if (const auto notice = take_drained()) notice();
}

void RemoteWire::tell_end(const std::string& reason) {
  wire::Frame frame = frame_for(wire_);
  frame.mutable_closed()->set_reason(told_reason(reason));
  send_frame(frame);
}

void RemoteWire::ask_for_end(const std::string& reason) {
  const std::lock_guard lock(mutex_);
  if (!cut_ && !std::exchange(asked_for_end_, true)) tell_end(reason);
}

void RemoteWire::count_passed_over(std::size_t messages) {
  port_.counters().dropped.fetch_add(messages, std::memory_order_relaxed);
}

void RemoteWire::pass_over() {
  const std::lock_guard lock(mutex_);
  passed_over_ = true;
}

void RemoteWire::cut(const std::string& reason, bool tell) {
  std::unordered_map<std::uint64_t, std::shared_ptr<ReplySink>> open;
  std::vector<std::shared_ptr<ReplySink>> served;
  std::deque<Held> dropped;
  bool tells = tell;
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(cut_, true)) return;  // the link may have gone since
    tells = tells && !asked_for_end_;
    drained_ = nullptr;
    for (const Kept& one : kept_) port_.counters().dropped += one.frame.has_object() ? 1 : 0;
    kept_.clear();
    dropped = end_held();
    open.swap(open_);
    for (auto& [id, weak] : served_) {
      if (auto reply = weak.lock()) served.push_back(std::move(reply));
    }
    served_.clear();
  }
  if (fan_out_) fan_out_->leave(wire_);  // before its end is told: nothing comes behind that
  if (tells) tell_end(reason);
  // What was sent, put or fired has been accepted: it goes, though the wire does, or is counted. Who has asked is told.
  const bool provides = port_.direction() == PortDirection::Provides;
  const bool counts = provides ? port_.service().pattern() != QUERY : port_.service().pattern() == SEND;
  const auto rest = counts && tell ? PeerLanes::Rest::Goes : PeerLanes::Rest::IsLost;
  const std::size_t lost = fan_out_ ? fan_out_->let_go(rest) : link_->close_lane(lane_, rest);
  if (counts) port_.counters().dropped.fetch_add(lost, std::memory_order_relaxed);
  for (auto& [id, reply] : open) reply->answer(Outcome::Disconnected, reason, nullptr);
  for (auto& reply : served) reply->abandon();
}

}  // namespace fiona::host
