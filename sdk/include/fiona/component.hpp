#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "fiona/async.hpp"
#include "fiona/error.hpp"
#include "fiona/event.hpp"
#include "fiona/master.hpp"
#include "fiona/modes.hpp"
#include "fiona/params.hpp"
#include "fiona/probe.hpp"
#include "fiona/push.hpp"
#include "fiona/query.hpp"
#include "fiona/send.hpp"
#include "fiona/task.hpp"
#include "fiona/time.hpp"
#include "fiona/trigger.hpp"

namespace fiona {

enum class LogLevel { Debug, Info, Warning, Error };

/// What an author writes: a class with ports, parameters, probes and tasks as members, each bound to its owner.
///
///     class StepCounter final : public fiona::Component {
///      public:
///       using Component::Component;
///      private:
///       void on_imu(const GetIMU& imu);
///       fiona::Requires<GetIMUService> imu_{*this, "imu", &StepCounter::on_imu};
///     };
///
/// The constructor declares and does nothing else: tools create a component only to see what it declares. Everything
/// it does runs on its instance's strand, one piece at a time, so members need no lock, except the work of a free
/// running task, which reaches members through `OwnThread::post`. An exception that leaves a handler or task fails the
/// instance with the exception's text; the host lives on.
class Component {
 public:
  explicit Component(Hull& hull) : hull_(hull) {}
  virtual ~Component() = default;
  Component(const Component&) = delete;
  Component& operator=(const Component&) = delete;

  /// [strand] Opens files and devices; throw Error to refuse: the load fails with its text, and there is no instance
  /// afterwards.
  virtual void on_start() {}
  /// [strand] Called once before destruction if `on_start` succeeded. Must not wait.
  virtual void on_stop() {}
  /// [strand] This mode has been entered: a main mode, `neutral` or `deactivated`.
  virtual void on_mode(std::string_view /*mode*/) {}

  /// [any thread] The instance's name.
  const std::string& name() const;
  /// [any thread] Now, on the instance's clock.
  TimePoint now() const;
  /// [any thread] When the instance's clock began.
  TimePoint clock_start() const;

  Hull& hull() const { return hull_; }

 protected:
  /// [any thread] A file that came with the package (its `share` folder). Throws Error NotFound.
  std::filesystem::path resource(std::string_view relative) const;
  /// [any thread] Ends the run of the whole system: a headless `fiona run` exits with `exit_code`.
  void end_run(int exit_code, std::string reason);
  /// [strand] Starts a coroutine of no handler: it waits, as for an answer, and holds no activity. What it throws fails
  /// the instance; it is destroyed with the instance if it has not ended by then.
  void spawn(Async<> work);
  /// [strand] While on, every call of this component that waits or is made, of all its ports or of those of one
  /// pattern, ends with Cancelled.
  void cancel_calls(bool on = true, std::optional<Pattern> pattern = std::nullopt);
  /// [any thread] One line for the host's log, under the instance's name.
  void log(LogLevel level, std::string_view text) const;

 private:
  Hull& hull_;
};

}  // namespace fiona
