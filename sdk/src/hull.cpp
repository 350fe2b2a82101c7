#include "fiona/hull.hpp"

#include <algorithm>
#include <cctype>
#include <exception>

#include "fiona/hull_probes.hpp"
#include "fiona/port.hpp"

namespace fiona {
namespace {

/// What is being thrown, as a reason. Call inside a catch block.
std::string reason_of_exception() {
  try {
    throw;
  } catch (const Error& error) {
    return error.text().where.empty() ? error.text().what : error.text().where + ": " + error.text().what;
  } catch (const std::exception& error) {
    return error.what();
  } catch (...) {
    return "threw something that is not a std::exception";
  }
}

}  // namespace

Hull::Hull(std::string name, Surroundings surroundings)
    : name_(std::move(name)),
      surroundings_(std::move(surroundings)),
      strand_(std::make_shared<Strand>(name_, surroundings_.executor, surroundings_.clock)),
      mode_probe_(std::make_unique<TextProbe>(*this, "mode")),
      error_probe_(std::make_unique<TextProbe>(*this, "last_error")) {
  tell_mode();
}

Hull::~Hull() {
  end_taps();
  strand_->close();
  if (tap_strand_) tap_strand_->close();
}

void Hull::create(const Factory& factory) {
  component_ = factory(*this);
  check_activities();
}

void Hull::add(Port& port) {
  require_free_name(port.name());
  ports_.push_back(&port);
}

void Hull::add(detail::TriggerBase& trigger) {
  require_free_name(trigger.name());
  triggers_.push_back(&trigger);
}

void Hull::add(detail::ProbeBase& probe) {
  const std::string& name = probe.name();
  const auto allowed = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '-'; };
  if (name.empty() || !std::all_of(name.begin(), name.end(), allowed)) {
    throw Error(ErrorCode::Usage, {.what = "'" + name + "' is no name for a probe",
                                   .where = name_,
                                   .expected = "letters, digits, '_' and '-'"});
  }
  require_free_name(name);
  probes_.push_back(&probe);
}

void Hull::require_free_name(std::string_view name) const {
  for (const HullProbe& own : hull_probes()) {
    if (own.of != HullProbe::Of::Instance || own.name != name) continue;
    throw Error(ErrorCode::Usage, {.what = "'" + std::string(name) + "' is a probe that every instance has",
                                   .where = name_,
                                   .next = "give the port, trigger or probe another name"});
  }
  if (!find_port(name) && !find_trigger(name) && !find_probe(name)) return;
  throw Error(ErrorCode::Usage, {.what = "two ports, triggers or probes are named '" + std::string(name) + "'",
                                 .where = name_,
                                 .next = "give each port, trigger and probe of a component a name of its own"});
}

detail::ProbeBase* Hull::find_probe(std::string_view name) const {
  const auto found = std::find_if(probes_.begin(), probes_.end(), [name](auto* one) { return one->name() == name; });
  return found == probes_.end() ? nullptr : *found;
}

detail::TriggerBase* Hull::find_trigger(std::string_view name) const {
  const auto found = std::find_if(triggers_.begin(), triggers_.end(), [name](auto* one) { return one->name() == name; });
  return found == triggers_.end() ? nullptr : *found;
}

Port* Hull::find_port(std::string_view name) const {
  const auto found = std::find_if(ports_.begin(), ports_.end(), [name](Port* port) { return port->name() == name; });
  return found == ports_.end() ? nullptr : *found;
}

std::string Hull::mode() const {
  const std::lock_guard lock(mutex_);
  return mode_;
}

std::string Hull::reason() const {
  const std::lock_guard lock(mutex_);
  return reason_;
}

void Hull::set_parameters(std::span<const control::Argument> changes, Duration deadline) {
  if (changes.empty()) return;
  if (!params_) {
    throw Error(ErrorCode::NotFound, {.what = "'" + name_ + "' has no parameters", .where = name_});
  }
  if (!strand_->call([this, changes] { params_->apply(changes); }, deadline)) {
    throw Error(ErrorCode::Unreachable, {.what = "'" + name_ + "' did not take the parameters in time: it is busy",
                                         .where = name_,
                                         .next = "show " + name_});
  }
}

Error Hull::failure() const {
  const std::lock_guard lock(mutex_);
  ErrorText text = refusal_.value_or(ErrorText{.what = reason_, .where = name_, .next = "show " + name_});
  text.what = "'" + name_ + "' failed: " + text.what;
  return Error(ErrorCode::ComponentFailed, std::move(text));
}

void Hull::start_component() {
  try {
    component_->on_start();
  } catch (const Error& error) {
    const std::lock_guard lock(mutex_);
    refusal_ = error.text();
    throw;
  }
}

void Hull::cancel_calls(bool on, std::optional<Pattern> pattern) {
  for (const Pattern one : {SEND, QUERY, PUSH_NEWEST, PUSH_TIMED, EVENT}) {
    if (pattern && one != *pattern) continue;
    on ? void(cancelled_.insert(one)) : void(cancelled_.erase(one));
  }
  if (!on) return;
  for (Port* port : ports_) {
    auto* client = dynamic_cast<RequiredPort*>(port);
    if (client && client->calls_are_cancelled()) client->calls_.finish_all(Outcome::Cancelled);
  }
}

void Hull::fail(const std::string& reason) {
  {
    const std::lock_guard lock(mutex_);
    if (mode_ == kModeFailed || mode_ == kModeShutdown) return;
    mode_ = kModeFailed;
    reason_ = reason;
  }
  active_.store(false, std::memory_order_release);
  // Tasks and timers find the instance not active and fall silent; they are cancelled on the strand.
  strand_->post([this] { leave_activities(kModeFailed); });
  tell_mode();
  events().mode_changed(name_, std::string(kModeFailed), reason);
}

bool Hull::shut_down(Duration deadline) {
  const auto end = [this] {
    leave_activities(kModeShutdown);
    drop_changes();
    for (Port* port : ports_) port->close();
    if (started_) guarded([this] { component_->on_stop(); });
    {
      const std::lock_guard lock(mutex_);
      if (mode_ != kModeFailed) mode_ = kModeShutdown;
    }
    strand_->close();
    spawned_.clear();
    component_.reset();
    ports_.clear();
    tasks_.clear();
    triggers_.clear();
    probes_.clear();
    timers_.clear();
    params_ = nullptr;
  };
  end_taps();
  if (!component_ || strand_->call(end, deadline)) return true;
  strand_->close();
  static_cast<void>(component_.release());
  return false;
}

void Hull::guarded(const std::function<void()>& work) {
  try {
    work();
  } catch (...) {
    fail(reason_of_exception());
  }
}

Async<> Hull::watched(Async<> work, std::list<Async<>>::iterator* self, Job then) {
  auto place = *self;
  try {
    co_await work;
  } catch (...) {
    fail(reason_of_exception());
  }
  // A coroutine cannot destroy itself: that is left to the strand's next job.
  strand_->post([this, place, then = std::move(then)]() mutable {
    spawned_.erase(place);
    then();
  });
}

bool Hull::spawn(Async<> work, Job then) {
  auto place = spawned_.begin();
  spawned_.push_front(watched(std::move(work), &place, std::move(then)));
  place = spawned_.begin();
  place->start();
  return false;
}

}  // namespace fiona
