#include "fiona/port.hpp"

#include <algorithm>
#include <utility>

#include "fiona/clock.hpp"
#include "fiona/hull.hpp"

namespace fiona {
namespace {

/// Changes of a connection that may wait for the strand one by one.
constexpr std::size_t kMostEntered = 16;

/// The field in which a pushed object says itself whether it is valid; null: it has none.
const google::protobuf::FieldDescriptor* validity_of(const ServiceInfo& service) {
  const auto* field = service.is_push() ? service.object().FindFieldByName("is_valid") : nullptr;
  return field && field->cpp_type() == field->CPPTYPE_BOOL && !field->is_repeated() ? field : nullptr;
}

}  // namespace

Port::Port(Component& owner, std::string_view name, PortDirection direction, const ServiceInfo& service,
           const PortOptions& options)
    : hull_(owner.hull()),
      name_(name),
      direction_(direction),
      service_(service),
      optional_(options.optional),
      doc_(options.doc),
      activity_(options.activity),
      calls_(hull_.clock(), hull_.shared_strand()) {
  hull_.add(*this);
}

bool Port::is_active() const { return served_.load(std::memory_order_acquire) && hull_.is_active(); }

void Port::set_served(bool served) {
  if (served_.exchange(served) && served) return;
  if (Inbox* in = inbox()) in->leave_mode();
  if (served) return on_active();
  on_inactive();  // of one that never was active, too: nobody is to take it for one that is just quiet
  calls_.finish_all(Outcome::NotActive);
}

void Port::cancel_calls(bool on) {
  cancelled_ = on;
  if (on) calls_.finish_all(Outcome::Cancelled);
}

bool Port::calls_are_cancelled() const { return cancelled_ || hull().calls_are_cancelled(service().pattern()); }

std::optional<Outcome> Port::obstacle() const {
  if (calls_are_cancelled()) return Outcome::Cancelled;
  return absence();
}

std::optional<Outcome> Port::absence() const { return is_active() ? std::nullopt : std::optional(Outcome::NotActive); }

std::string Port::full_name() const { return hull_.name() + "." + name_; }

TimePoint owner_now(const Port& port) { return port.hull().clock().now(); }

RequiredPort::RequiredPort(Component& owner, std::string_view name, const ServiceInfo& service,
                           const PortOptions& options)
    : Port(owner, name, PortDirection::Requires, service, options),
      is_push_(service.is_push()),
      validity_(validity_of(service)),
      ends_{std::make_shared<WireEnd>(*this, "")},
      serving_(ends_.front()) {
  since_ns_.store(hull().clock().now().time_since_epoch().count());
  serving_->open_ = !keeps_last();
}

std::optional<Outcome> RequiredPort::absence() const {
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
  if (entered_.size() == kMostEntered) take_entered_together();
  entered_.push_back({connection, ++changes_, std::move(news)});
  if (told_later_ == kMostEntered) return;
  ++told_later_;
  hull().strand().post([this] { tell_entered(); });
}

/// They come faster than the strand works: it is told of the last loss, and of the last of all.
void RequiredPort::take_entered_together() {
  const auto is_loss = [](const Entered& one) { return one.connection != Connection::Connected; };
  const auto loss = std::find_if(entered_.rbegin(), entered_.rend(), is_loss);
  std::deque<Entered> kept;
  if (loss != entered_.rend() && loss != entered_.rbegin()) kept.push_back(std::move(*loss));
  kept.push_back(std::move(entered_.back()));
  entered_ = std::move(kept);
  entered_.back().news = "its connection changes faster than this component works: some changes were taken together";
}

void RequiredPort::tell_entered() {
  std::deque<Entered> now;
  {
    const std::lock_guard lock(mutex_);
    if (--told_later_ == 0) {
      now.swap(entered_);
    } else if (!entered_.empty()) {
      now.push_back(std::move(entered_.front()));
      entered_.pop_front();
    }
  }
  for (const auto& [connection, change, news] : now) {
    if (!news.empty()) hull().events().logged(hull().name(), LogLevel::Warning, full_name() + ": " + news);
    on_connection(connection, change);
  }
}

std::string RequiredPort::reason_for(Outcome outcome) const {
  if (outcome == Outcome::Rejected) return "the queue to the provider is full";
  return outcome == Outcome::Unwired || outcome == Outcome::Disconnected ? connection_reason() : "";
}

std::string RequiredPort::connection_reason() const {
  const std::lock_guard lock(mutex_);
  return reason_;
}

}  // namespace fiona
