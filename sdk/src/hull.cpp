#include "fiona/hull.hpp"

#include <cxxabi.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <cstdio>
#include <exception>
#include <stdexcept>

#include "fiona/hull_probes.hpp"
#include "fiona/port.hpp"
#include "fiona/readable_text.hpp"
#include "own_thread.hpp"

namespace fiona {

std::string detail::reason_of_exception() {
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

namespace {

const std::string kEndsItsThread = "has ended the thread that it was called on (pthread_exit, or a cancellation)";

/// A forced unwind cannot be stopped: who catches it and goes on ends the process. So the thread goes no further; as
/// one that hangs it is found, and its group ended, or in `main` another thread put in its place.
[[noreturn]] void keep_thread(const std::string& instance) {
  std::fputs(("'" + instance + "' " + kEndsItsThread + "\n").c_str(), stderr);
  while (true) ::pause();
}

}  // namespace

std::exception_ptr detail::exception_of_coroutine() {
  if (auto error = std::current_exception()) return error;
  try {  // one of another language has no pointer, and the end of a thread is none
    throw;
  } catch (const abi::__forced_unwind&) {
    keep_thread(std::string(Strand::current_name()));
  } catch (...) {
    return std::make_exception_ptr(std::runtime_error("threw something that is not a std::exception"));
  }
}

Hull::Hull(std::string name, Surroundings surroundings)
    : name_(std::move(name)),
      surroundings_(std::move(surroundings)),
      strand_(std::make_shared<Strand>(name_, surroundings_.executor, surroundings_.clock)),
      mode_probe_(std::make_unique<TextProbe>(*this, "mode")),
      error_probe_(std::make_unique<TextProbe>(*this, "last_error")) {
  mode_since_ = clock().now();
  tell_mode();
}

Hull::~Hull() {
  end_taps();
  strand_->close();
  if (side_strand_) side_strand_->close();
}

const std::shared_ptr<Strand>& Hull::side_strand() {
  const std::lock_guard lock(taps_mutex_);
  if (!side_strand_) side_strand_ = std::make_shared<Strand>(name_ + "/side", surroundings_.executor, clock());
  return side_strand_;
}

void Hull::create(const Factory& factory) {
  component_ = factory(*this);
  check_activities();
  for (Task* task : tasks_) task->attach();
}

void Hull::add(Task& task) {
  const std::string& name = task.name();
  require_name("task", name);
  if (std::any_of(tasks_.begin(), tasks_.end(), [&name](const Task* one) { return one->name() == name; })) {
    throw Error(ErrorCode::Usage, {.what = "two tasks are named '" + name + "'",
                                   .where = name_,
                                   .next = "give each task a name of its own; one that puts has its port's"});
  }
  tasks_.push_back(&task);
}

void Hull::add(Port& port) {
  require_name("port", port.name());
  require_free_name(port.name());
  ports_.push_back(&port);
}

void Hull::add(detail::TriggerBase& trigger) {
  require_name("trigger", trigger.name());
  require_free_name(trigger.name());
  triggers_.push_back(&trigger);
}

void Hull::add(detail::ProbeBase& probe) {
  require_name("probe", probe.name());
  require_free_name(probe.name());
  probes_.push_back(&probe);
}

void Hull::add(Master& master) {
  if (master_) {
    throw Error(ErrorCode::Usage,
                {.what = "a component is master once", .where = name_, .next = "keep one member of fiona::Master"});
  }
  master_ = &master;
}

void Hull::answer(std::uint64_t number, control::Reply reply) {
  strand_->post([this, number, reply = std::move(reply)]() mutable {
    if (master_) master_->take(number, std::move(reply));
  });
}

/// As it is typed in a line of the console, without quotes, and with dots between the names.
void Hull::require_name(std::string_view kind, std::string_view name) const {
  const auto allowed = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '-'; };
  if (!name.empty() && std::all_of(name.begin(), name.end(), allowed)) return;
  throw Error(ErrorCode::Usage, {.what = "'" + std::string(name) + "' is no name for a " + std::string(kind),
                                 .where = name_,
                                 .expected = "letters, digits, '_' and '-'"});
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
  const auto found =
      std::find_if(triggers_.begin(), triggers_.end(), [name](auto* one) { return one->name() == name; });
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

std::size_t Hull::queue_depth() const {
  std::size_t depth = strand_->waiting_jobs();
  for (Port* port : ports_) {
    if (const Inbox* inbox = port->inbox()) depth += inbox->depth();
  }
  return depth;
}

TimePoint Hull::mode_since() const {
  const std::lock_guard lock(mutex_);
  return mode_since_;
}

std::string Hull::reason() const {
  const std::lock_guard lock(mutex_);
  return reason_;
}

void Hull::set_parameters(std::span<const control::Argument> changes, Duration deadline) {
  if (changes.empty()) return;
  if (!params_) {
    throw Error(
        ErrorCode::NotFound,
        {.what = "'" + name_ + "' has no parameters", .where = name_, .next = "show " + name_ + " tells what it has"});
  }
  // A copy: what has begun goes on after the deadline, when the caller's own are gone. It is taken back then.
  const auto kept = std::make_shared<std::vector<control::Argument>>(changes.begin(), changes.end());
  const auto decided = std::make_shared<std::atomic<bool>>(false);
  const auto apply = [this, kept, decided] {
    strand_->begins(Liveness::mark(kItsParameters));
    const auto former = params_->snapshot();
    params_->apply(*kept);
    if (decided->exchange(true)) params_->take_back(former);
  };
  if (!strand_->call(apply, deadline) && !decided->exchange(true)) {
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
  strand_->begins(Liveness::mark(kItsStart));
  try {
    component_->on_start();
  } catch (const Error& error) {
    const std::lock_guard lock(mutex_);
    refusal_ = error.text();
    throw;
  }
}

void Hull::cancel_calls(bool on, std::optional<Pattern> pattern) {
  if (!pattern) all_cancelled_ = on;
  if (pattern && on) cancelled_.insert(*pattern);
  if (pattern && !on) cancelled_.erase(*pattern);
  if (!on) return;
  if (master_ && !pattern) master_->calls_.finish_all(Outcome::Cancelled);
  for (Port* port : ports_) {
    if (port->calls_are_cancelled()) port->calls_.finish_all(Outcome::Cancelled);
  }
}

void Hull::fail(const std::string& thrown) {
  const std::string reason = readable_text(thrown);
  {
    const std::lock_guard lock(mutex_);
    if (mode_ == kModeFailed || mode_ == kModeShutdown) return;
    mode_ = kModeFailed;
    mode_since_ = clock().now();
    reason_ = reason;
    failed_.store(true, std::memory_order_release);
    active_.store(false, std::memory_order_release);
  }
  // Tasks and timers find the instance not active and fall silent; they are cancelled on the strand.
  strand_->post([this] { leave_activities(kModeFailed); });
  tell_mode();
  events().mode_changed(name_, std::string(kModeFailed), reason);
}

/// None: it has ended.
void Hull::note_thread(const Task& task, std::optional<std::stop_source> stop) {
  const std::lock_guard lock(mutex_);
  threads_.erase(&task);
  if (stop) threads_.emplace(&task, *stop);
}

void Hull::stop_threads() {
  std::vector<std::stop_source> threads;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [task, stop] : threads_) threads.push_back(stop);
  }
  if (threads.empty()) return;
  side_strand()->post([threads]() mutable {
    for (auto& stop : threads) stop.request_stop();
  });
}

std::optional<std::string> Hull::shut_down(Duration deadline) {
  using Threads = std::vector<std::pair<std::string, std::shared_ptr<OwnThread::Shared>>>;
  end_taps();
  if (!component_) return std::nullopt;
  const auto until = std::chrono::steady_clock::now() + deadline;
  const auto threads = std::make_shared<Threads>();
  const auto stop = [this, threads] {
    drop_changes();  // before what they wait for is let go
    leave_activities(kModeShutdown);
    for (Port* port : ports_) port->close();
    for (Task* task : tasks_) {
      if (task->own_) threads->emplace_back(task->name(), task->own_);
    }
  };
  std::optional<std::string> runs;
  if (!strand_->call(stop, deadline)) {
    runs = "its handler";
    stop_threads();
  }
  for (std::size_t i = 0; !runs && i < threads->size(); ++i) {
    if (!threads->at(i).second->wait_for_end(until)) runs = "its task '" + threads->at(i).first + "'";
  }
  if (!runs && !strand_->call([this] { destroy_component(); }, deadline)) runs = "its handler";
  if (!runs) return std::nullopt;
  strand_->close();
  static_cast<void>(component_.release());
  return runs;
}

void Hull::destroy_component() {
  strand_->begins(Liveness::mark(kItsStop));
  if (const auto failure = started_ ? thrown_by([this] { component_->on_stop(); }) : std::nullopt) {
    events().logged(name_, LogLevel::Error, "its stop failed: " + *failure);  // or nobody would hear of it
    fail(*failure);
  }
  strand_->begins(Liveness::mark(kItsDestructor));
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
  master_ = nullptr;
}

void Hull::guarded(const std::function<void()>& work) {
  if (const auto failure = thrown_by(work)) fail(*failure);
}

std::optional<std::string> Hull::thrown_by(const std::function<void()>& work) {
  try {
    work();
    return std::nullopt;
  } catch (const abi::__forced_unwind&) {
    fail(kEndsItsThread);
    keep_thread(name_);
  } catch (...) {
    return detail::reason_of_exception();
  }
}

Async<> Hull::watched(Async<> work, std::list<Async<>>::iterator* self, Job then) {
  auto place = *self;
  try {
    co_await work;
  } catch (...) {
    fail(detail::reason_of_exception());
  }
  // A coroutine cannot destroy itself: that is left to the strand's next job.
  strand_->post([this, place, then = std::move(then)]() mutable {
    spawned_.erase(place);
    if (then) then();
  });
}

void Hull::spawn(Async<> work, Job then) {
  auto place = spawned_.begin();
  spawned_.push_front(watched(std::move(work), &place, std::move(then)));
  place = spawned_.begin();
  place->start();
}

}  // namespace fiona
