#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/async.hpp"
#include "fiona/call.hpp"
#include "fiona/message.hpp"
#include "fiona/result.hpp"
#include "fiona/service.hpp"
#include "fiona/strand.hpp"

namespace fiona {

class ActivityHold;
class Component;
class Hull;
class RequiredPort;

enum class PortDirection { Provides, Requires };

/// A client port's place in its life (patterns.md, rules shared by all).
enum class Connection { Unwired, Waiting, Connected, Lost };
std::string_view to_string(Connection connection);

/// How a push subscription receives: the newest value only, or each one in order through a bounded queue.
enum class Delivery { Newest, Each };

/// What becomes of the open requests of a query client whose port is rewired: they end on the old provider, are put to
/// the new one (only where the service is idempotent), or end with Disconnected.
enum class AtRewire { Finish, Redirect, Fail };

/// What an author may say of a port beyond its service.
struct PortOptions {
  bool optional = false;  ///< the component can do without: no white spot, no complaint
  std::string_view doc = {};
  Delivery delivery = Delivery::Each;
  AtRewire at_rewire = AtRewire::Finish;
  std::string_view activity = {};  ///< the port works in the main modes that have it; empty: in all
};

/// Counters of a port, written on its strand or link, read by anyone.
struct PortCounters {
  std::atomic<std::uint64_t> messages{0};    ///< put, or received
  std::atomic<std::uint64_t> superseded{0};  ///< overwritten by a newer value before anyone read them
  std::atomic<std::uint64_t> dropped{0};     ///< lost to a full queue
  std::atomic<std::uint64_t> refused{0};     ///< failed the check of size, range or finiteness
  std::atomic<std::uint64_t> not_active{0};  ///< arrived in a mode that does not serve the port
  std::atomic<std::int64_t> newest_ns{-1};   ///< origin of the newest message on the instance's clock
  std::atomic<float> rate_hz{0};             ///< over the last second or so of the instance's clock

  /// [strand] One more message, of this origin.
  void count(TimePoint origin);
  /// [any thread] Of the newest message; none: there was none.
  std::optional<Duration> age(TimePoint now) const;
  /// [any thread] The rate, where it is not from long ago.
  double rate_now_hz(TimePoint now) const;

 private:
  std::int64_t window_start_ns_ = -1;
  std::uint64_t window_messages_ = 0;
};

/// Where the answer to a request goes. Shared by the request under way and whoever will answer it.
class ReplySink {
 public:
  virtual ~ReplySink() = default;
  /// [any thread] Ends the request; only the first call counts.
  virtual void answer(Outcome outcome, std::string reason, std::shared_ptr<const Object> object) = 0;
  /// [any thread] Of an activation that goes on: one event; without an object, that the provider has taken it.
  virtual Outcome event(Envelope /*event*/) { return Outcome::WrongId; }
  /// [any thread] The client gave up or is gone: nobody reads the answer.
  bool abandoned() const { return abandoned_.load(std::memory_order_acquire); }
  void abandon() {
    if (given_up_.exchange(true)) return;
    if (!in_turn_) note_abandoned();
    if (on_abandon_) on_abandon_();
  }
  void note_abandoned() { abandoned_.store(true, std::memory_order_release); }
  /// [before the request leaves] What tells the provider that nobody waits any more; `in_turn`: and calls
  /// `note_abandoned` when its turn has come.
  void set_on_abandon(std::function<void()> notice, bool in_turn = false) {
    on_abandon_ = std::move(notice);
    in_turn_ = in_turn;
  }

 private:
  std::atomic<bool> given_up_{false};
  std::atomic<bool> abandoned_{false};
  std::function<void()> on_abandon_;
  bool in_turn_ = false;
};

/// What a delivery log says of a delivery that has no object.
inline constexpr std::string_view kGivenUp = "given_up";
inline constexpr std::string_view kSpeaks = "speaks";
inline constexpr std::string_view kSilent = "silent";
inline constexpr std::string_view kTaken = "taken";

/// A message on its way into an inbox: with `reply`, a request.
struct Parcel {
  Envelope envelope;
  std::shared_ptr<ReplySink> reply;
  bool continuous = false;       ///< of an activation: each event, not the first only
  std::uint64_t activation = 0;  ///< of an event: which activation of the client's it is for

  /// Whether somebody waits for an answer to it.
  bool is_request() const { return reply && activation == 0; }
};

/// The far end of a wire as the near end sees it: an inbox of the same process, or a link to another.
class Sink {
 public:
  virtual ~Sink() = default;
  /// [any thread] Takes the message or says why not. Never waits, never runs a handler on the caller's stack.
  virtual Outcome deliver(Parcel parcel) = 0;
  /// [any thread] Whether a push provider speaks, or has been silent for longer than its lease.
  virtual void lease(bool /*held*/, const std::string& /*reason*/) {}
  /// [any thread] It subscribes to a push provider now, and is given what comes after this sequence number.
  virtual void attached(std::uint64_t /*sequence*/) {}
  /// [any thread] How many subscribers it stands for.
  virtual std::size_t subscribers() const { return 1; }
};

namespace detail {

/// Where the messages of a send, query or event client go. [any thread]
class Target {
 public:
  void set(std::shared_ptr<Sink> sink);
  /// Hands the message over; none: there is nowhere to go. What meets a wire that another has just replaced goes to
  /// that other one.
  std::optional<Outcome> deliver(const Parcel& parcel);

 private:
  std::shared_ptr<Sink> get();

  std::mutex mutex_;
  std::shared_ptr<Sink> sink_;
};

}  // namespace detail

/// A named member of a component that provides or requires one service. Declared by constructing it; it registers
/// with its owner, and lives exactly as long.
class Port {
 public:
  Port(Component& owner, std::string_view name, PortDirection direction, const ServiceInfo& service,
       const PortOptions& options);
  virtual ~Port() = default;
  Port(const Port&) = delete;
  Port& operator=(const Port&) = delete;

  const std::string& name() const { return name_; }
  PortDirection direction() const { return direction_; }
  const ServiceInfo& service() const { return service_; }
  bool optional() const { return optional_; }
  const std::string& doc() const { return doc_; }
  const std::string& activity() const { return activity_; }
  Hull& hull() const { return hull_; }
  /// [any thread] Whether the instance's mode serves this port.
  bool is_active() const;
  /// [strand] Told by the hull when the mode changes.
  void set_served(bool served);
  /// `instance.port`
  std::string full_name() const;
  PortCounters& counters() { return counters_; }

  /// [strand] The instance shuts down: end what waits, let go of sinks.
  virtual void close() {}

 protected:
  /// [strand] The instance has entered a mode that serves the port, or left it.
  virtual void on_active() {}
  virtual void on_inactive() {}

 private:
  Hull& hull_;
  const std::string name_;
  const PortDirection direction_;
  const ServiceInfo& service_;
  const bool optional_;
  const std::string doc_;
  const std::string activity_;
  std::atomic<bool> served_{false};
  PortCounters counters_;
};

/// The bounded queue in front of a handler, or the slot of a *newest* subscription.
class Inbox {
 public:
  /// Ends a parcel on the strand. An Async that it returns keeps the next parcel waiting until it has ended.
  using Handler = std::function<std::optional<Async<>>(const Parcel&)>;

  /// Bytes that may wait, unless a single message is larger (architecture 7.4).
  static constexpr std::size_t kMaxBytes = 4 * 1024 * 1024;

  Inbox(Port& port, Delivery delivery, Handler handler);
  ~Inbox();

  /// [any thread] Queues the parcel; when full, the oldest goes and is counted (push), or the parcel is refused
  /// with Rejected (send, query: nothing that a client counts on is dropped behind its back).
  Outcome push(Parcel parcel);

  /// The value in the slot of a *newest* inbox; stale: from a provider that has been replaced.
  struct Newest {
    Envelope envelope;
    bool stale = false;
  };
  /// [any thread] The slot of a *newest* inbox without handler; the value stays.
  std::optional<Newest> newest();
  /// [any thread] Calls `waiter` once, with the envelope, on the strand, when the next message has come.
  void on_next(std::function<void(const Envelope&)> waiter);
  /// [any thread] What is in the slot is from a provider that has been replaced.
  void mark_stale();
  /// [any thread] Empties the slot. What waits for a handler has arrived, and still reaches it.
  void empty_slot();
  /// [any thread] Empties queue and slot; requests are answered with `outcome`.
  void clear(Outcome outcome);

  Port& port() const { return port_; }

  /// [any thread] Messages that wait for the handler.
  std::size_t depth() const;

  /// [strand] Handles at most `limit` parcels.
  void drain(std::size_t limit);

 private:
  friend class Strand;
  Outcome push_each(std::unique_lock<std::mutex>& lock, Parcel parcel);
  void push_newest(std::unique_lock<std::mutex>& lock, Parcel parcel);
  void wake(std::unique_lock<std::mutex>& lock);
  void notify_waiters(const Envelope& envelope);
  bool make_room(std::size_t bytes);
  bool refill();
  void handle();
  void finish_parcel();
  bool is_push() const;

  Port& port_;
  Strand& strand_;
  const Delivery delivery_;
  const Handler handler_;

  // guarded by the strand's mutex
  std::deque<Parcel> queue_;
  std::optional<Newest> slot_;
  bool slot_read_ = true;
  bool ready_ = false;
  std::vector<std::function<void(const Envelope&)>> waiters_;

  std::atomic<std::size_t> bytes_{0};    ///< of queue_, batch_ and current_
  std::atomic<std::size_t> batched_{0};  ///< the size of batch_, for others than the strand

  // strand only
  std::deque<Parcel> batch_;
  std::optional<Parcel> current_;  ///< what the handler, perhaps a coroutine, refers to
  std::shared_ptr<ActivityHold> hold_;  ///< of a coroutine
};

/// A port that provides: messages leave through sinks (push) or enter through an inbox (send, query).
class ProvidedPort : public Port {
 public:
  ProvidedPort(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options)
      : Port(owner, name, PortDirection::Provides, service, options) {}
  /// The inbox of a send or query provider; null for a push.
  virtual Inbox* inbox() { return nullptr; }
  void close() override {
    if (Inbox* in = inbox()) in->clear(Outcome::Disconnected);
  }
};

/// The client's end of a wire: what its provider says, and how the wire is, reach the port through here. Of a port with
/// alternatives only the end that serves lets messages through. All functions [any thread].
class WireEnd final : public std::enable_shared_from_this<WireEnd> {
 public:
  WireEnd(RequiredPort& port, std::string provider) : port_(port), provider_(std::move(provider)) {}

  RequiredPort& port() const { return port_; }
  /// "instance.port"; empty: the port has not been wired.
  const std::string& provider() const { return provider_; }

  /// Of a push: into the port's inbox, if this end serves.
  Outcome push(Parcel parcel);
  /// Where the messages of a send, query or event client go while this end serves; null: nowhere.
  void set_target(std::shared_ptr<Sink> target);
  /// Called by the host's wiring. What that means to waits and calls: patterns.md's table.
  void set_connection(Connection connection, std::string reason);
  /// The provider of a connected wire is silent, or speaks again.
  void set_lease(bool held, const std::string& reason);
  /// Of an end that is to take the place of a port's only one: the port's.
  Connection connection() const;

 private:
  friend class RequiredPort;
  // guarded by the port's mutex
  bool is_live() const { return connection_ == Connection::Connected && !silence_; }
  bool is_fit() const { return is_live() && valid_; }
  std::string unfitness() const;

  RequiredPort& port_;
  const std::string provider_;
  std::atomic<bool> open_{false};  ///< it is the port's only one: nothing has to be asked
  Connection connection_ = Connection::Unwired;
  std::string reason_ = "not wired";
  std::optional<std::string> silence_;  ///< why, of a provider that is silent
  bool valid_ = true;                   ///< as its last object says
  bool heard_ = false;                  ///< it has said something since it was connected
  TimePoint fit_since_{};               ///< and heard
  std::shared_ptr<Sink> target_;
  std::optional<Envelope> last_;        ///< of a service that has a last value
};

/// A port that requires. It has one wire, or one to each of several providers, of which the first that is fit serves:
/// connected, not silent for longer than its lease, and its last object valid (`is_valid`, where its type has that).
/// When who serves is fit no longer, the next one serves at once; a better one serves again after it has spoken, and
/// been fit without a break for the hold time.
class RequiredPort : public Port {
 public:
  static constexpr Duration kDefaultHold = std::chrono::seconds(3);

  RequiredPort(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options);

  /// The inbox of a push client; null for send and query.
  virtual Inbox* inbox() { return nullptr; }
  void close() override { on_connection(Connection::Unwired); }

  /// [strand] While on, every call of this port that waits or is made ends with Cancelled. The same for all ports:
  /// `Component::cancel_calls`.
  void cancel_calls(bool on = true);
  bool calls_are_cancelled() const;

  /// [any thread]
  Connection connection() const { return connection_.load(); }
  std::string connection_reason() const;
  /// [any thread] When it entered its connection state, on the instance's clock.
  TimePoint connection_since() const { return TimePoint(Duration(since_ns_.load())); }

  /// [any thread] The end for a wire from this provider: of one that it was arranged for, or one that takes the place of
  /// the port's only end once it is connected.
  std::shared_ptr<WireEnd> end_for(const std::string& provider);
  /// [any thread] From now on these are its providers, the best first; none: it is wired no longer. Those that it has
  /// already stay as they are. Called by the host's wiring.
  void arrange(const std::vector<std::string>& providers, Duration hold);

  /// One of several providers.
  struct Alternative {
    std::string provider;
    Connection connection = Connection::Unwired;
    std::string reason;  ///< why it is not fit
    bool fit = false;
    bool serves = false;
  };
  /// [any thread] In their order; empty: it has no alternatives.
  std::vector<Alternative> alternatives() const;
  /// [any thread] How often who served, or was about to serve again, was fit no longer.
  std::uint64_t flaps() const { return flaps_.load(std::memory_order_relaxed); }

 protected:
  /// [any thread] Where the messages of a send, query or event client go from now on; null: nowhere.
  virtual void use_target(std::shared_ptr<Sink> /*target*/) {}
  /// [any thread] The connection changes, before anything more arrives.
  virtual void on_entering(Connection) {}
  /// [strand] The connection has changed.
  virtual void on_connection(Connection) {}
  void on_inactive() override { calls_.finish_all(Outcome::NotActive); }
  /// [strand] Why a call cannot be made now, if so.
  std::optional<Outcome> obstacle() const;
  detail::Calls& calls() { return calls_; }

 private:
  friend class Hull;
  friend class WireEnd;
  using Ends = std::vector<std::shared_ptr<WireEnd>>;

  // alternatives.cpp; all but the first with the mutex
  void arm_return();
  bool owns(const WireEnd& end) const;
  bool adopts(WireEnd& end);
  bool keeps_last() const { return service().contract().last_value(); }
  void connected(WireEnd& end, Connection connection, std::string reason);
  void leased(WireEnd& end, bool held, const std::string& reason);
  Outcome take(WireEnd& end, Parcel parcel);
  template <class Change>
  void change(WireEnd& end, const Change& make);
  void choose();
  std::shared_ptr<WireEnd> best() const;
  TimePoint next_return() const;
  void serve(const std::shared_ptr<WireEnd>& chosen, bool again);
  void serve_only();
  void enter_unfit();
  bool says_valid(const Object& object) const;
  /// Of a provider that has not pushed anything since it was connected nothing is known: it takes nobody's place.
  bool may_return(const WireEnd& end) const { return end.is_fit() && (end.heard_ || !is_push_); }
  void enter(Connection connection, std::string reason, std::string news = {});

  detail::Calls calls_;
  bool cancelled_ = false;  ///< strand only
  std::atomic<Connection> connection_{Connection::Unwired};
  std::atomic<std::int64_t> since_ns_{0};
  std::atomic<std::uint64_t> flaps_{0};
  const bool is_push_;
  const google::protobuf::FieldDescriptor* const validity_;  ///< `is_valid` of its objects; null: they have none

  mutable std::mutex mutex_;
  std::string reason_ = "not wired";
  Ends ends_;                         ///< never empty
  std::shared_ptr<WireEnd> serving_;  ///< one of them
  Duration hold_ = kDefaultHold;
  TimerId return_timer_ = 0;          ///< strand only
};

/// A wire within one process: hands parcels to the inbox at its end, every `prescale`-th of a push.
class LocalWire final : public Sink, public std::enable_shared_from_this<LocalWire> {
 public:
  /// Of a send, query or event: to the provider's inbox.
  LocalWire(std::string name, Inbox& inbox);
  /// Of a push: to the client's end.
  LocalWire(std::string name, std::shared_ptr<WireEnd> end, std::uint32_t prescale);
  Outcome deliver(Parcel parcel) override;
  void lease(bool held, const std::string& reason) override;
  /// [any thread] After it returned nothing more reaches the inbox.
  void cut();
  /// [any thread] Cuts it if it ends at a port of this hull.
  void cut_from(const Hull& hull);
  const std::string& name() const { return name_; }

 private:
  Outcome hand_over(Parcel parcel);
  void stage(std::unique_lock<std::mutex>& lock, const Object* object, std::string_view word, Job deliver);
  void give_up_in_turn(const std::shared_ptr<ReplySink>& reply);

  const std::string name_;  ///< "client.port<provider.port", orders deliveries in virtual time
  const std::uint32_t prescale_;
  const std::shared_ptr<WireEnd> end_;  ///< of a push
  std::mutex mutex_;
  Inbox* inbox_;  ///< null once cut
  Clock& clock_;
  std::uint64_t puts_ = 0;
  std::uint64_t staged_ = 0;
};

}  // namespace fiona
