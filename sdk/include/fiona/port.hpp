#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/call.hpp"
#include "fiona/inbox.hpp"
#include "fiona/port_counters.hpp"
#include "fiona/port_options.hpp"
#include "fiona/result.hpp"
#include "fiona/service.hpp"
#include "fiona/sink.hpp"
#include "fiona/wire_end.hpp"

namespace fiona {

class Component;
class Hull;

enum class PortDirection { Provides, Requires };

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
  /// Where messages arrive: of a push client, and of a send, query or event provider; null: none do.
  virtual Inbox* inbox() { return nullptr; }
  /// [strand] Whether what arrives begins something, which it must not in a mode that is about to be left.
  virtual bool begins_work() const { return true; }

  /// [strand] The instance shuts down: end what waits, let go of sinks.
  virtual void close() {}

  /// [strand] While on, every call of this port that waits or is made ends with Cancelled. The same for all ports:
  /// `Component::cancel_calls`.
  void cancel_calls(bool on = true);
  /// [strand] Whether they end so now: by this port's flag, by that of its pattern or component, or `deactivated`.
  bool calls_are_cancelled() const;

 protected:
  /// [strand] The instance has entered a mode that serves the port, or left it; calls that wait end with NotActive.
  virtual void on_active() {}
  virtual void on_inactive() {}
  /// [strand] Why a call cannot be made now, if so.
  std::optional<Outcome> obstacle() const;
  /// [strand] The same, but that calls are cancelled.
  virtual std::optional<Outcome> absence() const;
  detail::Calls& calls() { return calls_; }

 private:
  friend class Hull;
  Hull& hull_;
  const std::string name_;
  const PortDirection direction_;
  const ServiceInfo& service_;
  const bool optional_;
  const std::string doc_;
  const std::string activity_;
  std::atomic<bool> served_{false};
  PortCounters counters_;
  detail::Calls calls_;
  bool cancelled_ = false;  ///< strand only
};

/// A port that provides: messages leave through sinks (push) or enter through an inbox (send, query).
class ProvidedPort : public Port {
 public:
  ProvidedPort(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options)
      : Port(owner, name, PortDirection::Provides, service, options) {}
  void close() override {
    if (Inbox* in = inbox()) in->clear(Outcome::Disconnected);
  }
};

/// A port that requires. It has one wire, or one to each of several providers, of which the first that is fit serves:
/// connected, not silent for longer than its lease, and its last object valid (`is_valid`, where its type has that).
/// When who serves is fit no longer, the next one serves at once; a better one serves again after it has spoken, and
/// been fit without a break for the hold time.
class RequiredPort : public Port {
 public:
  static constexpr Duration kDefaultHold = std::chrono::seconds(3);

  RequiredPort(Component& owner, std::string_view name, const ServiceInfo& service, const PortOptions& options);

  void close() override { on_connection(Connection::Unwired, std::numeric_limits<std::uint64_t>::max()); }

  /// [any thread] Unwired, waiting, connected or lost.
  Connection connection() const { return connection_.load(); }
  /// [any thread] Why, as `show INSTANCE.PORT` prints it.
  std::string connection_reason() const;
  /// [any thread] When it entered its connection state, on the instance's clock.
  TimePoint connection_since() const { return TimePoint(Duration(since_ns_.load())); }

  /// [any thread] The end for a wire from this provider: of one that it was arranged for, or one that takes the place
  /// of the port's only end once it is connected.
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
  /// [any thread] Open requests that a change of the provider would put to the next one.
  virtual std::size_t redirectable() const { return 0; }
  /// [any thread] How often who served, or was about to serve again, was fit no longer.
  std::uint64_t flaps() const { return flaps_.load(std::memory_order_relaxed); }

 protected:
  /// [any thread] Where the messages of a send, query or event client go from now on; null: nowhere.
  virtual void use_target(std::shared_ptr<Sink> /*target*/) {}
  /// [any thread] The connection changes, before anything more arrives.
  virtual void on_entering(Connection) {}
  /// [strand] The connection has changed, for the `change`-th time. What was put since then is not concerned: the
  /// strand may have been busy meanwhile.
  virtual void on_connection(Connection, std::uint64_t /*change*/) {}
  /// [any thread] How often it has changed. Asked before something is put, so that nothing which goes to the provider
  /// of before is taken for a later one.
  std::uint64_t changes() const { return changes_.load(); }
  /// [any thread] Of who serves.
  Result<Duration> provider_cycle() const;
  /// [strand] Hands the last value of who serves to the port once more, where the service has one.
  void repeat_last();
  std::optional<Outcome> absence() const override;
  /// [any thread] What there is to say of the outcome of a call that could not be made.
  std::string reason_for(Outcome outcome) const;

 private:
  friend class WireEnd;
  using Ends = std::vector<std::shared_ptr<WireEnd>>;
  /// A change of the connection that the strand has not been told of.
  struct Entered {
    Connection connection;
    std::uint64_t change;
    std::string news;  ///< for the log
  };

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
  std::string_view flaw_of(const Envelope& envelope);
  /// Of a provider that has not pushed anything since it was connected nothing is known: it takes nobody's place.
  bool may_return(const WireEnd& end) const { return end.is_fit() && (end.heard_ || !is_push_); }
  void enter(Connection connection, std::string reason, std::string news = {});
  void take_entered_together();
  /// [strand, without the mutex]
  void tell_entered();

  std::atomic<Connection> connection_{Connection::Unwired};
  std::atomic<std::int64_t> since_ns_{0};
  std::atomic<std::uint64_t> flaps_{0};
  std::atomic<std::uint64_t> changes_{0};
  const bool is_push_;
  const google::protobuf::FieldDescriptor* const validity_;  ///< `is_valid` of its objects; null: they have none

  mutable std::mutex mutex_;
  std::string reason_ = "not wired";
  Ends ends_;                         ///< never empty
  std::shared_ptr<WireEnd> serving_;  ///< one of them
  Duration hold_ = kDefaultHold;
  std::deque<Entered> entered_;
  std::size_t told_later_ = 0;  ///< jobs on the strand, each for one of them, the last for what is left
  TimerId return_timer_ = 0;    ///< strand only
};

}  // namespace fiona
