#include "fiona/port.hpp"

#include <chrono>
#include <utility>

#include "fiona/clock.hpp"
#include "fiona/hull.hpp"

namespace fiona {
namespace {

/// What a message costs in memory beside its serialised size: object, queue entry, shared count.
constexpr std::size_t kMessageOverhead = 256;
/// Parcels that leave the queue at once, so that "drop the oldest" finds most of them still there.
constexpr std::size_t kBatch = 64;
/// How long an inbox is served before the strand looks at what else waits.
constexpr std::chrono::milliseconds kTurn{2};

std::size_t cost(const Parcel& parcel) { return parcel.envelope.bytes + kMessageOverhead; }

bool is_push(const ServiceInfo& service) {
  return service.pattern() == PUSH_NEWEST || service.pattern() == PUSH_TIMED;
}

/// The field in which a pushed object says itself whether it is valid; null: it has none.
const google::protobuf::FieldDescriptor* validity_of(const ServiceInfo& service) {
  const auto* field = is_push(service) ? service.object().FindFieldByName("is_valid") : nullptr;
  return field && field->cpp_type() == field->CPPTYPE_BOOL && !field->is_repeated() ? field : nullptr;
}

}  // namespace

std::string_view to_string(Connection connection) {
  switch (connection) {
    case Connection::Unwired: return "unwired";
    case Connection::Waiting: return "waiting";
    case Connection::Connected: return "connected";
    case Connection::Lost: return "lost";
  }
  return "unknown";
}

void PortCounters::count(TimePoint origin) {
  messages.fetch_add(1, std::memory_order_relaxed);
  const std::int64_t now_ns = origin.time_since_epoch().count();
  newest_ns.store(now_ns, std::memory_order_relaxed);
  constexpr std::int64_t kWindowNs = 1'000'000'000;
  // Origins may step back a little, as those of the rows of a radio scan do: that is no new beginning.
  constexpr std::int64_t kStepBackNs = 60 * kWindowNs;
  if (window_start_ns_ < 0 || now_ns < window_start_ns_ - kStepBackNs) {
    window_start_ns_ = now_ns;
    window_messages_ = 0;
    return;
  }
  ++window_messages_;
  const std::int64_t elapsed_ns = now_ns - window_start_ns_;
  if (elapsed_ns < kWindowNs) return;
  rate_hz.store(static_cast<float>(static_cast<double>(window_messages_) * 1e9 / static_cast<double>(elapsed_ns)),
                std::memory_order_relaxed);
  window_start_ns_ = now_ns;
  window_messages_ = 0;
}

std::optional<Duration> PortCounters::age(TimePoint now) const {
  const std::int64_t newest = newest_ns.load(std::memory_order_relaxed);
  if (newest < 0) return std::nullopt;
  return std::max(Duration::zero(), now.time_since_epoch() - Duration(newest));
}

double PortCounters::rate_now_hz(TimePoint now) const {
  const auto newest = age(now);
  return !newest || *newest > std::chrono::seconds(3) ? 0.0 : static_cast<double>(rate_hz.load(std::memory_order_relaxed));
}

Port::Port(Component& owner, std::string_view name, PortDirection direction, const ServiceInfo& service,
           const PortOptions& options)
    : hull_(owner.hull()),
      name_(name),
      direction_(direction),
      service_(service),
      optional_(options.optional),
      doc_(options.doc),
      activity_(options.activity) {
  hull_.add(*this);
}

bool Port::is_active() const { return served_.load(std::memory_order_acquire) && hull_.is_active(); }

void Port::set_served(bool served) {
  if (served_.exchange(served) == served) return;
  served ? on_active() : on_inactive();
}

std::string Port::full_name() const { return hull_.name() + "." + name_; }

TimePoint owner_now(const Port& port) { return port.hull().clock().now(); }

// ---- inbox ----------------------------------------------------------------------------------------------------

Inbox::Inbox(Port& port, Delivery delivery, Handler handler)
    : port_(port), strand_(port.hull().strand()), delivery_(delivery), handler_(std::move(handler)) {}

Inbox::~Inbox() = default;

bool Inbox::is_push() const { return fiona::is_push(port_.service()); }

Outcome Inbox::push(Parcel parcel) {
  // An acknowledged send: the wire passes on what is returned here, and nothing is left to answer later.
  if (port_.service().pattern() == SEND && std::exchange(parcel.reply, nullptr) && !port_.is_active()) {
    return Outcome::NotActive;
  }
  std::unique_lock lock(strand_.mutex_);
  if (strand_.closed_) return Outcome::Disconnected;
  if (delivery_ == Delivery::Each) return push_each(lock, std::move(parcel));
  push_newest(lock, std::move(parcel));
  return Outcome::Ok;
}

Outcome Inbox::push_each(std::unique_lock<std::mutex>& lock, Parcel parcel) {
  const std::size_t bytes = cost(parcel);
  if (!make_room(bytes)) return Outcome::Rejected;
  bytes_.fetch_add(bytes, std::memory_order_relaxed);
  notify_waiters(parcel.envelope);
  queue_.push_back(std::move(parcel));
  wake(lock);
  return Outcome::Ok;
}

void Inbox::push_newest(std::unique_lock<std::mutex>& lock, Parcel parcel) {
  if (!handler_) {
    if (!port_.is_active()) {
      port_.counters().not_active.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    port_.counters().count(parcel.envelope.origin);
    if (slot_ && !slot_read_) port_.counters().superseded.fetch_add(1, std::memory_order_relaxed);
    notify_waiters(parcel.envelope);
    slot_ = Newest{std::move(parcel.envelope), false};
    slot_read_ = false;
    return;
  }
  for (const Parcel& old : queue_) {
    bytes_.fetch_sub(cost(old), std::memory_order_relaxed);
    port_.counters().superseded.fetch_add(1, std::memory_order_relaxed);
  }
  queue_.clear();
  bytes_.fetch_add(cost(parcel), std::memory_order_relaxed);
  queue_.push_back(std::move(parcel));
  wake(lock);
}

/// A full push queue loses its oldest entries, counted; a full queue of requests takes no more.
bool Inbox::make_room(std::size_t bytes) {
  const auto full = [&] {
    const std::size_t waiting = bytes_.load(std::memory_order_relaxed);
    return waiting > 0 && waiting + bytes > kMaxBytes;
  };
  if (!is_push()) return !full();
  while (full() && !queue_.empty()) {
    bytes_.fetch_sub(cost(queue_.front()), std::memory_order_relaxed);
    port_.counters().dropped.fetch_add(1, std::memory_order_relaxed);
    queue_.pop_front();
  }
  return true;
}

void Inbox::wake(std::unique_lock<std::mutex>& lock) {
  if (!ready_) {
    ready_ = true;
    strand_.ready_.push_back(this);
  }
  strand_.wake(lock);
}

/// Called with the strand's mutex held: the waiters run as jobs of the strand.
void Inbox::notify_waiters(const Envelope& envelope) {
  if (waiters_.empty()) return;
  for (auto& waiter : std::exchange(waiters_, {})) {
    strand_.jobs_.emplace_back([waiter = std::move(waiter), envelope] { waiter(envelope); });
  }
  if (strand_.scheduled_) return;
  strand_.scheduled_ = true;
  if (strand_.clock_.strand_busy(strand_)) strand_.start();
}

std::optional<Inbox::Newest> Inbox::newest() {
  const std::lock_guard lock(strand_.mutex_);
  slot_read_ = true;
  return slot_;
}

void Inbox::on_next(std::function<void(const Envelope&)> waiter) {
  const std::lock_guard lock(strand_.mutex_);
  waiters_.push_back(std::move(waiter));
}

void Inbox::mark_stale() {
  const std::lock_guard lock(strand_.mutex_);
  if (slot_) slot_->stale = true;
}

void Inbox::empty_slot() {
  const std::lock_guard lock(strand_.mutex_);
  slot_.reset();
  slot_read_ = true;
}

void Inbox::clear(Outcome outcome) {
  std::deque<Parcel> dropped;
  {
    const std::lock_guard lock(strand_.mutex_);
    dropped.swap(queue_);
    slot_.reset();
    slot_read_ = true;
    for (const Parcel& parcel : dropped) bytes_.fetch_sub(cost(parcel), std::memory_order_relaxed);
  }
  for (const Parcel& parcel : dropped) {
    if (parcel.is_request()) parcel.reply->answer(outcome, {}, nullptr);
  }
}

bool Inbox::refill() {
  const std::lock_guard lock(strand_.mutex_);
  while (!queue_.empty() && batch_.size() < kBatch) {
    batch_.push_back(std::move(queue_.front()));
    queue_.pop_front();
  }
  batched_.store(batch_.size(), std::memory_order_relaxed);
  return !batch_.empty();
}

std::size_t Inbox::depth() const {
  const std::lock_guard lock(strand_.mutex_);
  return queue_.size() + batched_.load(std::memory_order_relaxed);
}

void Inbox::drain(std::size_t limit) {
  std::chrono::steady_clock::time_point begun{};
  for (std::size_t handled = 0; !current_; ++handled) {
    if (batch_.empty() && !refill()) return;
    if (handled == 1) begun = std::chrono::steady_clock::now();
    const bool long_enough = handled > 1 && std::chrono::steady_clock::now() - begun > kTurn;
    if (handled == limit || long_enough) {
      std::unique_lock lock(strand_.mutex_);
      wake(lock);
      return;
    }
    current_ = std::move(batch_.front());
    batch_.pop_front();
    handle();
    if (strand_.closed_) return;
  }
}

/// Ends the current parcel, or leaves it to the coroutine that the handler returned.
void Inbox::handle() {
  Hull& hull = port_.hull();
  if (current_->reply && current_->reply->abandoned()) return finish_parcel();
  if (!port_.is_active() || hull.is_leaving(port_.activity())) {
    port_.counters().not_active.fetch_add(1, std::memory_order_relaxed);
    if (current_->is_request()) current_->reply->answer(Outcome::NotActive, "mode " + hull.mode(), nullptr);
    return finish_parcel();
  }
  port_.counters().count(current_->envelope.origin);
  std::optional<Async<>> coroutine;
  hull.guarded([&] { coroutine = handler_(*current_); });
  if (!coroutine) return finish_parcel();
  if (auto hold = hull.acquire(port_.activity(), "the handler of '" + port_.name() + "'")) {
    hold_ = std::make_shared<ActivityHold>(std::move(*hold));
  }
  hull.spawn(std::move(*coroutine), [this] {
    finish_parcel();
    drain(kBatch);
  });
}

void Inbox::finish_parcel() {
  bytes_.fetch_sub(cost(*current_), std::memory_order_relaxed);
  current_.reset();
  hold_.reset();
}

// ---- required port and local wire -----------------------------------------------------------------------------

namespace detail {

void Target::set(std::shared_ptr<Sink> sink) {
  const std::lock_guard lock(mutex_);
  sink_ = std::move(sink);
}

std::shared_ptr<Sink> Target::get() {
  const std::lock_guard lock(mutex_);
  return sink_;
}

std::optional<Outcome> Target::deliver(const Parcel& parcel) {
  for (auto sink = get(); sink;) {
    const Outcome outcome = sink->deliver(parcel);
    auto present = get();
    if (outcome != Outcome::Disconnected || present == sink) return outcome;
    sink = std::move(present);
  }
  return std::nullopt;
}

}  // namespace detail

RequiredPort::RequiredPort(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options)
    : Port(owner, name, PortDirection::Requires, service, options),
      calls_(hull().clock(), hull().shared_strand()),
      is_push_(is_push(service)),
      validity_(validity_of(service)),
      ends_{std::make_shared<WireEnd>(*this, "")},
      serving_(ends_.front()) {
  serving_->open_ = !keeps_last();
}

void RequiredPort::cancel_calls(bool on) {
  cancelled_ = on;
  if (on) calls_.finish_all(Outcome::Cancelled);
}

bool RequiredPort::calls_are_cancelled() const { return cancelled_ || hull().calls_are_cancelled(service().pattern()); }

std::optional<Outcome> RequiredPort::obstacle() const {
  if (calls_are_cancelled()) return Outcome::Cancelled;
  if (!is_active()) return Outcome::NotActive;
  if (connection() == Connection::Unwired) return Outcome::Unwired;
  if (connection() == Connection::Lost) return Outcome::Disconnected;
  return std::nullopt;
}

/// Called with the mutex held. `news`: for the log.
void RequiredPort::enter(Connection connection, std::string reason, std::string news) {
  reason_ = std::move(reason);
  connection_.store(connection);
  since_ns_.store(hull().clock().now().time_since_epoch().count());
  on_entering(connection);
  hull().strand().post([this, connection, news = std::move(news)] {
    if (!news.empty()) hull().events().logged(hull().name(), LogLevel::Warning, full_name() + ": " + news);
    on_connection(connection);
  });
}

std::string RequiredPort::connection_reason() const {
  const std::lock_guard lock(mutex_);
  return reason_;
}

LocalWire::LocalWire(std::string name, Inbox& inbox)
    : name_(std::move(name)), prescale_(1), inbox_(&inbox), clock_(inbox.port().hull().clock()) {}

LocalWire::LocalWire(std::string name, std::shared_ptr<WireEnd> end, std::uint32_t prescale)
    : name_(std::move(name)),
      prescale_(std::max(1U, prescale)),
      end_(std::move(end)),
      inbox_(end_->port().inbox()),
      clock_(end_->port().hull().clock()) {}

Outcome LocalWire::deliver(Parcel parcel) {
  std::unique_lock lock(mutex_);
  if (!inbox_) return Outcome::Disconnected;
  if (puts_++ % prescale_ != 0) return Outcome::Ok;
  if (!clock_.staging()) return hand_over(std::move(parcel));
  if (parcel.is_request()) give_up_in_turn(parcel.reply);
  const Object* object = parcel.envelope.object.get();
  stage(lock, object, {}, [self = shared_from_this(), parcel = std::move(parcel)]() mutable {
    const std::lock_guard inner(self->mutex_);
    const auto reply = parcel.reply;
    const Outcome outcome = self->hand_over(std::move(parcel));
    if (reply && outcome != Outcome::Ok) reply->answer(outcome, {}, nullptr);
  });
  return Outcome::Ok;
}

/// Lets go of the lock first: the clock may deliver at once.
void LocalWire::stage(std::unique_lock<std::mutex>& lock, const Object* object, std::string_view word, Job deliver) {
  const std::uint64_t sequence = ++staged_;
  lock.unlock();
  clock_.stage({name_, sequence, object, word, std::move(deliver)});
}

/// That the client has given up reaches the provider as a message does: behind what it sent before, and in its turn.
void LocalWire::give_up_in_turn(const std::shared_ptr<ReplySink>& reply) {
  reply->set_on_abandon(
      [self = shared_from_this(), weak = std::weak_ptr(reply)] {
        std::unique_lock lock(self->mutex_);
        self->stage(lock, nullptr, kGivenUp, [self, reply = weak.lock()] { reply->note_abandoned(); });
      },
      true);
}

/// Called with the mutex held, so that after `cut` nothing is under way.
Outcome LocalWire::hand_over(Parcel parcel) {
  if (!inbox_) return Outcome::Disconnected;
  if (end_) return end_->push(std::move(parcel));
  const auto receipt = inbox_->port().service().pattern() == SEND ? parcel.reply : nullptr;
  const Outcome outcome = inbox_->push(std::move(parcel));
  if (receipt) receipt->answer(outcome, {}, nullptr);
  return outcome;
}

void LocalWire::lease(bool held, const std::string& reason) {
  const auto tell = [self = shared_from_this(), held, reason] {
    const std::lock_guard lock(self->mutex_);
    if (self->inbox_ && self->end_) self->end_->set_lease(held, reason);
  };
  if (!clock_.staging()) return tell();
  std::unique_lock lock(mutex_);
  stage(lock, nullptr, held ? kSpeaks : kSilent, tell);
}

void LocalWire::cut() {
  const std::lock_guard lock(mutex_);
  inbox_ = nullptr;
}

void LocalWire::cut_from(const Hull& hull) {
  const std::lock_guard lock(mutex_);
  if (inbox_ && &inbox_->port().hull() == &hull) inbox_ = nullptr;
}

}  // namespace fiona
