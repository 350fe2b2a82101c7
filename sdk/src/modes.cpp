#include "fiona/modes.hpp"

#include <algorithm>
#include <future>
#include <set>
#include <utility>

#include "fiona/component.hpp"
#include "fiona/hull.hpp"

namespace fiona {

Modes::Modes(Component& owner, std::initializer_list<MainMode> modes) {
  std::set<std::string> taken;
  for (const auto reserved : {kModeInit, kModeNeutral, kModeDeactivated, kModeFailed, kModeShutdown})
    taken.emplace(reserved);
  for (const MainMode& mode : modes) {
    if (!mode.name.empty() && taken.insert(mode.name).second) continue;
    throw Error(ErrorCode::Usage,
                {.what = "'" + mode.name + "' cannot be a main mode: the name is reserved or given twice",
                 .where = owner.name(),
                 .expected = "names of their own, other than init, neutral, deactivated, failed, shutdown"});
  }
  if (modes.size() == 0) {
    throw Error(ErrorCode::Usage, {.what = "no main mode is named",
                                   .where = owner.name(),
                                   .next = "name one, or leave Modes out: a component without has 'active'"});
  }
  owner.hull().declare(modes);
}

// ---- the machine ----------------------------------------------------------------------------------------------

void Hull::declare(std::vector<MainMode> modes) {
  if (std::exchange(declares_modes_, true)) {
    throw Error(ErrorCode::Usage, {.what = "a component has one list of main modes",
                                   .where = name_,
                                   .next = "name the modes of both in one member of fiona::Modes"});
  }
  for (const MainMode& mode : modes) require_name("mode", mode.name);
  modes_ = std::move(modes);
}

std::vector<std::string> Hull::main_modes() const {
  std::vector<std::string> names;
  for (const auto& mode : modes_) names.push_back(mode.name);
  return names;
}

bool Hull::serves(std::string_view mode, std::string_view activity) const {
  const auto found = std::find_if(modes_.begin(), modes_.end(), [&](const MainMode& one) { return one.name == mode; });
  if (found == modes_.end()) return false;
  return activity.empty() ||
         std::find(found->activities.begin(), found->activities.end(), activity) != found->activities.end();
}

void Hull::check_activities() const {
  std::set<std::string> known{""};
  for (const auto& mode : modes_) known.insert(mode.activities.begin(), mode.activities.end());
  const auto require = [&](const std::string& user, const std::string& activity) {
    if (known.contains(activity)) return;
    throw Error(ErrorCode::Usage,
                {.what = "'" + user + "' names the activity '" + activity + "', which no main mode has",
                 .where = name_,
                 .near = nearest_names(activity, std::vector<std::string>(known.begin(), known.end()))});
  };
  for (const Port* port : ports_) require(port->name(), port->activity());
  for (const Task* task : tasks_) require(task->name(), task->activity());
  for (const auto* trigger : triggers_) require(trigger->name(), trigger->activity());
}

/// Virtual time stands while anything runs, which a free running task always does; and when its results came would
/// depend on the machine.
void Hull::check_clock(std::string_view mode) const {
  if (!clock().staging()) return;
  for (const Task* task : tasks_) {
    if (!task->is_free_running() || !serves(mode, task->activity())) continue;
    throw Error(ErrorCode::NotAllowed,
                {.what = "'" + name_ + "' cannot go to " + std::string(mode) + " on a virtual clock",
                 .where = name_,
                 .expected = "a mode without its task '" + task->name() + "'",
                 .found = "that task runs in a thread of its own, for which virtual time cannot wait",
                 .next = "set host clock=system"});
  }
}

/// A change of mode that was asked for.
struct Hull::ModeChange {
  std::string to;
  ModeDone done;
  TimePoint until = TimePoint::max();  ///< who has asked waits no longer
  TimerId deadline = 0;

  Error late(const std::string& name, const std::string& what) const {
    return {ErrorCode::Unreachable,
            {.what = "'" + name + "' did not change its mode to " + to + " in time: " + what,
             .where = name,
             .next = "state " + name + " " + to + " for TIME, with more of it"}};
  }
};

std::optional<Hull::PendingChange> Hull::pending_change() const {
  const std::lock_guard lock(mutex_);
  return pending_;
}

void Hull::check_transition(std::string_view to) const {
  const std::string from = mode();
  std::vector<std::string> modes = main_modes();
  modes.emplace_back(kModeNeutral);
  modes.emplace_back(kModeDeactivated);
  const bool known = std::find(modes.begin(), modes.end(), to) != modes.end();
  const bool alive = from != kModeFailed && from != kModeShutdown;
  if (known && alive) return;
  const bool is_made = from != kModeInit;  // else there will be no instance
  std::string expected;
  for (const auto& mode : modes) expected += (expected.empty() ? "" : ", ") + mode;
  throw Error(known ? ErrorCode::NotAllowed : ErrorCode::Usage,
              {.what = "'" + name_ + "' cannot go from " + from + " to " + std::string(to),
               .where = name_,
               .expected = known ? "an instance that is alive" : "one of " + expected,
               .found = known ? from + (reason().empty() ? "" : ": " + reason()) : std::string(to),
               .next = known     ? "unload " + name_ + ", then load it again"
                       : is_made ? "state " + name_ + " " + modes.front()
                                 : "load it at " + modes.front(),
               .near = known ? std::vector<std::string>{} : nearest_names(to, modes)});
}

void Hull::change_mode(std::string_view mode, Duration deadline, ModeDone done) {
  check_transition(mode);
  check_clock(mode);
  const TimePoint until = saturating_sum(clock().now(), deadline);
  const auto change = std::make_shared<ModeChange>(ModeChange{std::string(mode), std::move(done), until, 0});
  strand_->post([this, change] {
    if (clock().now() > change->until) {
      const auto blocked = blocked_by(change->to);
      return change->done(
          change->late(name_, blocked ? "blocked by " + blocked->blocked_by : "a handler ran until then"));
    }
    changes_.push_back(change);
    change->deadline = clock().schedule(change->until, strand_, [this, change] { withdraw(change); });
    if (change->to == kModeDeactivated) cancel_for_deactivation();
    advance_changes();
  });
}

void Hull::set_mode(std::string_view mode, Duration deadline) {
  const auto end = std::make_shared<std::promise<std::optional<Error>>>();
  auto ended = end->get_future();
  change_mode(mode, deadline, [end](const std::optional<Error>& error) { end->set_value(error); });
  surroundings_.executor.help();
  if (ended.wait_for(deadline) != std::future_status::ready) {
    throw Error(ErrorCode::Unreachable,
                {.what = "'" + name_ + "' did not change its mode in time: a handler still runs, or it has ended",
                 .where = name_,
                 .next = "show " + name_});
  }
  if (const auto error = ended.get()) throw *error;
}

/// Its time is up: what blocks it goes on, and so does the next in the queue.
void Hull::withdraw(const std::shared_ptr<ModeChange>& change) {
  if (std::erase(changes_, change) == 0) return;
  const auto pending = pending_change();
  deactivated_ = mode() == kModeDeactivated || waits_for_deactivation();
  const std::string by = pending ? ": blocked by " + pending->blocked_by : "";
  advance_changes();
  for (Task* task : tasks_) task->resume();
  change->done(Error(ErrorCode::Unreachable,
                     {.what = "'" + name_ + "' did not change its mode to " + change->to + " in time" + by,
                      .where = name_,
                      .next = "state " + name_ + " deactivated, which cancels what waits"}));
}

bool Hull::waits_for_deactivation() const {
  return std::any_of(changes_.begin(), changes_.end(), [](const auto& one) { return one->to == kModeDeactivated; });
}

void Hull::abandon_changes() {
  strand_->post([this] { drop_changes(); });
}

/// The instance shuts down, which waits for nobody.
void Hull::drop_changes() {
  for (const auto& change : std::exchange(changes_, {})) {
    clock().cancel(change->deadline);
    change->done(Error(ErrorCode::Unreachable,
                       {.what = "'" + name_ + "' was unloaded", .where = name_, .next = "load it again, or undo"}));
  }
}

/// Neutral waits for what runs; deactivated ends its waits first, so that it comes to an end.
void Hull::cancel_for_deactivation() {
  deactivated_ = true;
  if (master_) master_->calls_.finish_all(Outcome::Cancelled);
  for (Port* port : ports_) port->calls_.finish_all(Outcome::Cancelled);
}

void Hull::advance_changes() {
  while (!changes_.empty()) {
    const auto change = changes_.front();
    auto blocked = blocked_by(change->to);
    {
      const std::lock_guard lock(mutex_);
      pending_ = blocked;
    }
    if (blocked) {
      for (Task* task : tasks_) {
        if (!serves(change->to, task->activity())) task->ask_to_stop();
      }
      return;
    }
    changes_.pop_front();
    clock().cancel(change->deadline);
    const std::string from = mode();
    enter(change->to);
    const bool is_late = mode() == change->to && from != kModeInit && clock().now() > change->until;
    if (is_late) go_back(from);
    change->done(mode() == kModeFailed ? std::optional(failure())
                 : is_late             ? std::optional(change->late(name_, "it took longer, and goes back to " + from))
                                       : std::nullopt);
  }
  const std::lock_guard lock(mutex_);
  pending_.reset();
}

/// Whoever asked has been told that it was not made.
void Hull::go_back(const std::string& to) {
  changes_.push_front(std::make_shared<ModeChange>(ModeChange{to, [](const auto&) {}}));
  if (to == kModeDeactivated) cancel_for_deactivation();
}

std::optional<Hull::PendingChange> Hull::blocked_by(const std::string& to) const {
  for (const auto& [number, held] : held_) {
    if (!serves(to, held.activity)) return PendingChange{to, held.by, held.since};
  }
  return std::nullopt;
}

bool Hull::is_leaving(std::string_view activity) const {
  return !changes_.empty() && !serves(changes_.front()->to, activity);
}

std::optional<ActivityHold> Hull::acquire(std::string_view activity, std::string_view by) {
  if (!serves(mode(), activity) || is_leaving(activity)) return std::nullopt;
  held_.emplace(next_hold_, Held{std::string(activity), std::string(by), clock().now()});
  return ActivityHold(*this, next_hold_++);
}

void Hull::release(std::uint64_t hold) {
  held_.erase(hold);
  if (!changes_.empty()) strand_->post([this] { advance_changes(); });
}

void Hull::enter(std::string_view to) {
  const std::string from = mode();
  if (from == to || from == kModeFailed || from == kModeShutdown) return;
  if (from == kModeInit) {
    guarded([this] { start_component(); });
    if (mode() == kModeFailed) return;
    started_ = true;
  }
  deactivated_ = to == kModeDeactivated || waits_for_deactivation();
  leave_activities(to);
  {
    const std::lock_guard lock(mutex_);
    if (mode_ == kModeFailed || mode_ == kModeShutdown) return;  // given up while it left the mode before
    mode_ = to;
    mode_since_ = clock().now();
    active_.store(serves(to, ""), std::memory_order_release);
  }
  tell_mode();
  for (Task* task : tasks_) {
    if (serves(to, task->activity())) task->start();
  }
  for (Port* port : ports_) port->set_served(serves(to, port->activity()));
  strand_->begins(Liveness::mark(kItsModeChange));
  guarded([this, to] { component_->on_mode(to); });
  if (mode() == to) events().mode_changed(name_, std::string(to), {});
}

/// Ends what works in this mode and not in `to`.
void Hull::leave_activities(std::string_view to) {
  if (!serves(to, "")) {
    active_.store(false, std::memory_order_release);
    for (Timer* timer : timers_) timer->cancel();
    if (master_) master_->calls_.finish_all(Outcome::NotActive);
  }
  for (Task* task : tasks_) {
    if (!serves(to, task->activity())) task->stop();
  }
  for (Port* port : ports_) {
    if (!serves(to, port->activity())) port->set_served(false);
  }
}

}  // namespace fiona
