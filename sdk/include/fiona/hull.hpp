#pragma once

#include <filesystem>
#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/async.hpp"
#include "fiona/clock.hpp"
#include "fiona/component.hpp"
#include "fiona/strand.hpp"

namespace fiona {

/// What an instance tells its surroundings. All calls [any thread], and must not wait.
class HullEvents {
 public:
  virtual ~HullEvents() = default;
  virtual void mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) = 0;
  virtual void run_ended(const std::string& instance, int exit_code, const std::string& reason) = 0;
  virtual void logged(const std::string& instance, LogLevel level, std::string_view text) = 0;
};

inline constexpr std::string_view kModeInit = "init";
inline constexpr std::string_view kModeNeutral = "neutral";
inline constexpr std::string_view kModeActive = "active";
inline constexpr std::string_view kModeFailed = "failed";
inline constexpr std::string_view kModeShutdown = "shutdown";

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
  /// strand did not take it within `deadline`.
  void set_parameters(std::span<const control::Argument> changes, Duration deadline);
  /// [any thread but the strand] init -> `mode` (on_start, then on_mode), or from one mode of life to another.
  /// Illegal transitions throw Error naming what is allowed; a component that refuses is `failed`, thrown as
  /// ComponentFailed.
  void set_mode(std::string_view mode, Duration deadline);
  /// [any thread but the strand] Closes the ports, cancels tasks, runs on_stop, drains; then the component is
  /// destroyed. False if the strand did not come free within `deadline`: the component is then leaked on purpose,
  /// since destroying it under a running handler would take the process down.
  bool shut_down(Duration deadline);

  /// [any thread] Fails the instance with a reason; the first reason stays.
  void fail(const std::string& reason);

  const std::string& name() const { return name_; }
  std::string mode() const;
  std::string reason() const;
  bool is_active() const { return active_.load(std::memory_order_acquire); }
  std::vector<std::string> main_modes() const { return {std::string(kModeActive)}; }

  Clock& clock() const { return surroundings_.clock; }
  Strand& strand() const { return *strand_; }
  const std::shared_ptr<Strand>& shared_strand() const { return strand_; }
  HullEvents& events() const { return surroundings_.events; }
  const std::filesystem::path& share() const { return surroundings_.share; }

  /// Fixed once the component has been made.
  const std::vector<Port*>& ports() const { return ports_; }
  const std::vector<Task*>& tasks() const { return tasks_; }
  detail::ParamsBase* parameters() const { return params_; }
  /// Null when there is none.
  Port* find_port(std::string_view name) const;

  /// [strand] Starts `work`. True if it has ended at once; else `then` runs on the strand when it has. The hull owns
  /// it, and destroys it with the instance if it never ends. What it throws fails the instance.
  bool spawn(Async<> work, Job then);
  /// [strand] While on, the calls of all ports, or of those of a pattern, end with Cancelled.
  void cancel_calls(bool on, std::optional<Pattern> pattern = std::nullopt);
  bool calls_are_cancelled(Pattern pattern) const { return cancelled_.contains(pattern); }

  /// [strand] Runs `work`, and fails the instance with what it throws.
  void guarded(const std::function<void()>& work);

 private:
  friend class Port;
  friend class Task;
  friend class Timer;
  friend class detail::ParamsBase;

  void add(Port& port);
  void enter(std::string_view mode);
  void start_component();
  [[noreturn]] void throw_failure() const;
  void leave_main_mode();
  void check_transition(std::string_view to) const;
  Async<> watched(Async<> work, std::list<Async<>>::iterator* self, Job then);

  const std::string name_;
  const Surroundings surroundings_;
  std::shared_ptr<Strand> strand_;
  std::vector<Port*> ports_;
  std::vector<Task*> tasks_;
  std::set<Timer*> timers_;
  detail::ParamsBase* params_ = nullptr;
  std::list<Async<>> spawned_;  ///< strand only
  std::set<Pattern> cancelled_;  ///< strand only
  std::unique_ptr<Component> component_;
  bool started_ = false;

  mutable std::mutex mutex_;
  std::string mode_{kModeInit};
  std::string reason_;
  std::optional<ErrorText> refusal_;  ///< what on_start threw, kept whole for whoever asked for the mode
  std::atomic<bool> active_{false};
};

}  // namespace fiona
