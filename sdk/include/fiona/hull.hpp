#pragma once

#include <deque>
#include <filesystem>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/async.hpp"
#include "fiona/clock.hpp"
#include "fiona/component.hpp"
#include "fiona/strand.hpp"
#include "fiona/tap.hpp"

namespace fiona {

/// What an instance tells its surroundings. All calls [any thread], and must not wait.
class HullEvents {
 public:
  virtual ~HullEvents() = default;
  /// It is in `mode` now; `reason` says why it has failed, and is empty otherwise.
  virtual void mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) = 0;
  /// The component has ended the run of the system (`Component::end_run`).
  virtual void run_ended(const std::string& instance, int exit_code, const std::string& reason) = 0;
  /// A line for the log, of the component or of its hull.
  virtual void logged(const std::string& instance, LogLevel level, std::string_view text) = 0;
  /// The component asks the host for something; `Hull::answer` brings the answer.
  virtual void asked(const std::string& instance, std::uint64_t number, const control::Request& request) = 0;
};

class Hull;

/// What an instance does beside the work of its ports, tasks and triggers, as `Liveness` marks it.
inline constexpr std::string_view kItsConstructor = "its constructor";
inline constexpr std::string_view kItsStart = "its start";
inline constexpr std::string_view kItsModeChange = "its change of mode";
inline constexpr std::string_view kItsParameters = "its parameters";
inline constexpr std::string_view kItsStop = "its stop";
inline constexpr std::string_view kItsDestructor = "its destructor";

namespace detail {

/// What is being thrown, as a reason. Call inside a catch block.
std::string reason_of_exception();

}  // namespace detail

/// Running work that holds an activity; while one lives no change of mode leaves it. [strand]
class ActivityHold {
 public:
  ActivityHold(Hull& hull, std::uint64_t number) : hull_(&hull), number_(number) {}
  ActivityHold(ActivityHold&& other) noexcept : hull_(std::exchange(other.hull_, nullptr)), number_(other.number_) {}
  ActivityHold& operator=(ActivityHold&& other) noexcept {
    std::swap(hull_, other.hull_);
    std::swap(number_, other.number_);
    return *this;
  }
  ~ActivityHold();

 private:
  Hull* hull_;
  std::uint64_t number_;
};

/// The component hull (document 2.1.1): between a component's inside and the system. Hosts and test benches use it;
/// component authors meet it only through `Component`, ports, tasks and parameters.
class Hull {
 public:
  struct Surroundings {
    Executor& executor;
    Clock& clock;
    HullEvents& events;
    std::filesystem::path share;  ///< the package's files
  };
  using Factory = std::function<std::unique_ptr<Component>(Hull&)>;

  Hull(std::string name, Surroundings surroundings);
  ~Hull();
  Hull(const Hull&) = delete;
  Hull& operator=(const Hull&) = delete;

  /// [any thread, once] Makes the component: mode `init`. What the constructor throws passes through.
  void create(const Factory& factory);
  /// [any thread but the strand] Sets parameters; throws Error as ParamsBase::apply does, Unreachable when the
  /// strand did not take it within `deadline`: what it takes later is taken back.
  void set_parameters(std::span<const control::Argument> changes, Duration deadline);
  /// [any thread] init -> `mode` (on_start, then on_mode), or from one mode of life to another, once what the old mode
  /// leaves is free. Requests queue in their order. Illegal transitions throw Error naming what is allowed. `done` is
  /// called once, on the strand: with ComponentFailed if the component refused; with Unreachable, naming what blocked
  /// it, if the change was not made by the deadline and was withdrawn. It is not called once the strand has been
  /// closed.
  using ModeDone = std::function<void(const std::optional<Error>&)>;
  void change_mode(std::string_view mode, Duration deadline, ModeDone done);
  /// [any thread] It is to be shut down: changes that wait are answered before anything that they wait for ends.
  void abandon_changes();
  /// [any thread but the strand] The same, waiting for it at most for `deadline` of the machine's own time.
  void set_mode(std::string_view mode, Duration deadline);
  /// [any thread but the strand] Closes the ports, cancels tasks, waits for their threads, runs on_stop, drains; then
  /// the component is destroyed. If strand and threads did not come free within `deadline`, says what still runs ("its
  /// handler"): the component is then leaked on purpose, since destroying it under what runs would
  /// take the process down; the hull, which that still uses, is the caller's to keep.
  std::optional<std::string> shut_down(Duration deadline);

  /// [any thread] Fails the instance with a reason; the first reason stays.
  void fail(const std::string& reason);
  /// [any thread] Asks free running tasks to stop, where its strand hangs, which would have asked them.
  void stop_threads();

  const std::string& name() const { return name_; }
  std::string mode() const;
  std::string reason() const;
  /// [any thread] When it entered its mode, on its clock.
  TimePoint mode_since() const;
  bool is_active() const { return active_.load(std::memory_order_acquire); }
  /// [any thread] It takes part in nothing any more.
  bool has_failed() const { return failed_.load(std::memory_order_acquire); }
  std::vector<std::string> main_modes() const;
  const std::vector<MainMode>& modes() const { return modes_; }
  /// [any thread] Whether `mode` is a main mode that has the activity; empty: any main mode.
  bool serves(std::string_view mode, std::string_view activity) const;
  struct PendingChange {
    std::string to;
    std::string blocked_by;
    TimePoint since;  ///< when that began to run
  };
  /// [any thread] The change of mode that waits for an activity to come free.
  std::optional<PendingChange> pending_change() const;

  Clock& clock() const { return surroundings_.clock; }
  Strand& strand() const { return *strand_; }
  const std::shared_ptr<Strand>& shared_strand() const { return strand_; }
  /// [any thread] Beside the component's: for what goes on though a handler of it hangs.
  const std::shared_ptr<Strand>& side_strand();
  HullEvents& events() const { return surroundings_.events; }
  const std::filesystem::path& share() const { return surroundings_.share; }

  /// Fixed once the component has been made.
  const std::vector<Port*>& ports() const { return ports_; }
  /// [any thread] Pieces of work that wait for its strand: jobs, and messages in front of handlers.
  std::size_t queue_depth() const;
  const std::vector<Task*>& tasks() const { return tasks_; }
  detail::ParamsBase* parameters() const { return params_; }
  const std::vector<detail::TriggerBase*>& triggers() const { return triggers_; }
  const std::vector<detail::ProbeBase*>& probes() const { return probes_; }
  /// Whether it asks for the right to change the system.
  bool asks_to_be_master() const { return master_ != nullptr; }
  /// [any thread] The host's answer to what it asked with this number.
  void answer(std::uint64_t number, control::Reply reply);
  /// Null when there is none.
  Port* find_port(std::string_view name) const;
  detail::TriggerBase* find_trigger(std::string_view name) const;
  detail::ProbeBase* find_probe(std::string_view name) const;

  // Monitoring. A name is that of a probe which the component declares, of one of the hull's own ("mode",
  // "location.rate", see hull_probes.hpp), or to `watch` that of a port that pushes. An unknown one throws Error
  // NotFound. All [one thread, not the strand], in any mode: they look at the component and touch nothing of it.

  /// The value of now; no object: there is none yet.
  Envelope read(std::string_view name) const;
  /// Empty where it has none.
  std::string unit_of(std::string_view name) const;
  /// Tells `watcher` from now on as `terms` say, of a probe beginning with the value of now; until `untap`, or until
  /// the instance ends. Throws Error Usage for what cannot be watched so.
  std::shared_ptr<Tap> tap(std::string_view name, TapTerms terms, std::shared_ptr<Watcher> watcher);
  /// After it returned the watcher is not called any more.
  void untap(const std::shared_ptr<Tap>& tap);

  /// [strand] Starts `work`; `then` runs on the strand when it has ended, as a job of its own. The hull owns it, and
  /// destroys it with the instance if it never ends. What it throws fails the instance.
  void spawn(Async<> work, Job then = {});
  /// [strand] While on, the calls of all ports, or of those of a pattern, end with Cancelled.
  void cancel_calls(bool on, std::optional<Pattern> pattern = std::nullopt);
  bool calls_are_cancelled(Pattern pattern) const { return all_calls_are_cancelled() || cancelled_.contains(pattern); }
  bool all_calls_are_cancelled() const { return deactivated_ || all_cancelled_; }

  /// [strand] Whether a change waits that leaves this activity: nothing new begins in it.
  bool is_leaving(std::string_view activity) const;
  /// [strand] Holds an activity of the present mode; none if the mode has it not, or is about to be left. `by` is shown
  /// to whoever waits.
  std::optional<ActivityHold> acquire(std::string_view activity, std::string_view by);

  /// [strand] Runs `work`, and fails the instance with what it throws.
  void guarded(const std::function<void()>& work);

 private:
  friend class Port;
  friend class Task;
  friend class Timer;
  friend class detail::ParamsBase;
  friend class detail::TriggerBase;
  friend class detail::ProbeBase;
  friend class ActivityHold;
  friend class Modes;
  friend class Master;
  struct ModeChange;
  struct TapPoint;
  struct Held {
    std::string activity;
    std::string by;
    TimePoint since;
  };

  /// A probe of the hull's own that tells each change.
  class TextProbe final : public detail::ProbeBase {
   public:
    TextProbe(Hull& hull, std::string_view name) : ProbeBase(hull, name, "string", *probe::Text::descriptor(), {}) {}
    /// [one thread at a time]
    void set(std::string text);

   private:
    std::shared_ptr<const Object> value() const override;
    std::optional<std::string> text_;
  };

  void add(Port& port);
  void add(detail::TriggerBase& trigger);
  void add(detail::ProbeBase& probe);
  void add(Master& master);
  void add(Task& task);
  void note_thread(const Task& task, std::optional<std::stop_source> stop);
  void require_name(std::string_view kind, std::string_view name) const;
  void require_free_name(std::string_view name) const;
  std::optional<std::string> thrown_by(const std::function<void()>& work);
  TapPoint tap_point(std::string_view name) const;
  std::vector<std::string> tappable_names() const;
  void end_taps();
  void tell_mode();
  void declare(std::vector<MainMode> modes);
  void check_activities() const;
  void check_clock(std::string_view mode) const;
  void cancel_for_deactivation();
  void advance_changes();
  void go_back(const std::string& to);
  void drop_changes();
  bool waits_for_deactivation() const;
  void withdraw(const std::shared_ptr<ModeChange>& change);
  std::optional<PendingChange> blocked_by(const std::string& to) const;
  void release(std::uint64_t hold);
  void enter(std::string_view mode);
  void start_component();
  void destroy_component();
  Error failure() const;
  void leave_activities(std::string_view to);
  void check_transition(std::string_view to) const;
  Async<> watched(Async<> work, std::list<Async<>>::iterator* self, Job then);

  const std::string name_;
  const Surroundings surroundings_;
  std::shared_ptr<Strand> strand_;
  std::vector<Port*> ports_;
  std::vector<Task*> tasks_;
  std::vector<detail::TriggerBase*> triggers_;
  std::vector<detail::ProbeBase*> probes_;
  std::mutex tell_mutex_;
  const std::unique_ptr<TextProbe> mode_probe_;
  const std::unique_ptr<TextProbe> error_probe_;
  std::mutex taps_mutex_;
  std::shared_ptr<Strand> side_strand_;  ///< made for the first who needs it
  std::vector<std::shared_ptr<Tap>> taps_;
  std::set<Timer*> timers_;
  detail::ParamsBase* params_ = nullptr;
  Master* master_ = nullptr;
  std::list<Async<>> spawned_;  ///< strand only
  bool all_cancelled_ = false;  ///< strand only, as are the next five
  std::set<Pattern> cancelled_;
  bool deactivated_ = false;
  std::deque<std::shared_ptr<ModeChange>> changes_;
  std::map<std::uint64_t, Held> held_;  ///< by age
  std::uint64_t next_hold_ = 1;
  std::vector<MainMode> modes_{{std::string(kModeActive), {}}};  ///< fixed once the component has been made
  bool declares_modes_ = false;
  std::unique_ptr<Component> component_;
  bool started_ = false;

  mutable std::mutex mutex_;
  std::string mode_{kModeInit};
  TimePoint mode_since_;
  std::string reason_;
  std::optional<PendingChange> pending_;
  std::map<const Task*, std::stop_source> threads_;  ///< of free running tasks
  std::optional<ErrorText> refusal_;                 ///< what on_start threw, kept whole for whoever asked for the mode
  std::atomic<bool> active_{false};
  std::atomic<bool> failed_{false};
};

inline ActivityHold::~ActivityHold() {
  if (hull_) hull_->release(number_);
}

}  // namespace fiona
