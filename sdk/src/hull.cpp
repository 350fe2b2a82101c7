#include "fiona/hull.hpp"

#include <algorithm>
#include <exception>

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
      strand_(std::make_shared<Strand>(name_, surroundings_.executor, surroundings_.clock)) {}

Hull::~Hull() { strand_->close(); }

void Hull::create(const Factory& factory) { component_ = factory(*this); }

void Hull::add(Port& port) {
  if (find_port(port.name())) {
    throw Error(ErrorCode::Usage, {.what = "two ports are named '" + port.name() + "'",
                                   .where = name_,
                                   .next = "give each port of a component a name of its own"});
  }
  ports_.push_back(&port);
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

void Hull::check_transition(std::string_view to) const {
  const std::string from = mode();
  std::vector<std::string> modes = main_modes();
  modes.emplace_back(kModeNeutral);
  const bool known = std::find(modes.begin(), modes.end(), to) != modes.end();
  const bool alive = from != kModeFailed && from != kModeShutdown;
  if (known && alive) return;
  std::string expected;
  for (const auto& mode : modes) expected += (expected.empty() ? "" : ", ") + mode;
  throw Error(known ? ErrorCode::NotAllowed : ErrorCode::Usage,
              {.what = "'" + name_ + "' cannot go from " + from + " to " + std::string(to),
               .where = name_,
               .expected = known ? "an instance that is alive" : "one of " + expected,
               .found = known ? from + (reason().empty() ? "" : ": " + reason()) : std::string(to),
               .next = known ? "unload " + name_ + ", then load it again" : "state " + name_ + " " + modes.front(),
               .near = nearest_names(to, modes)});
}

void Hull::set_mode(std::string_view mode, Duration deadline) {
  check_transition(mode);
  if (!strand_->call([this, to = std::string(mode)] { enter(to); }, deadline)) {
    throw Error(ErrorCode::Unreachable,
                {.what = "'" + name_ + "' did not change its mode in time: a handler still runs, or it has ended",
                 .where = name_,
                 .next = "show " + name_});
  }
  if (this->mode() == kModeFailed) throw_failure();
}

void Hull::throw_failure() const {
  const std::lock_guard lock(mutex_);
  ErrorText text = refusal_.value_or(ErrorText{.what = reason_, .where = name_, .next = "show " + name_});
  text.what = "'" + name_ + "' failed: " + text.what;
  throw Error(ErrorCode::ComponentFailed, std::move(text));
}

void Hull::enter(std::string_view to) {
  const std::string from = mode();
  if (from == to || from == kModeFailed || from == kModeShutdown) return;
  if (from == kModeInit) {
    guarded([this] { start_component(); });
    if (mode() == kModeFailed) return;
    started_ = true;
  } else if (from != kModeNeutral) {
    leave_main_mode();
  }
  {
    const std::lock_guard lock(mutex_);
    mode_ = to;
  }
  active_.store(to != kModeNeutral, std::memory_order_release);
  if (to != kModeNeutral) {
    for (Task* task : tasks_) task->start();
    for (Port* port : ports_) port->on_active();
  }
  guarded([this, to] { component_->on_mode(to); });
  if (mode() == to) events().mode_changed(name_, std::string(to), {});
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

void Hull::leave_main_mode() {
  active_.store(false, std::memory_order_release);
  for (Task* task : tasks_) task->stop();
  for (Timer* timer : timers_) timer->cancel();
  for (Port* port : ports_) port->on_inactive();
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
  strand_->post([this] { leave_main_mode(); });
  events().mode_changed(name_, std::string(kModeFailed), reason);
}

bool Hull::shut_down(Duration deadline) {
  const auto end = [this] {
    leave_main_mode();
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
    timers_.clear();
    params_ = nullptr;
  };
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
