#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "fiona/control.pb.h"
#include "clock_master.hpp"
#include "delivery_log.hpp"
#include "fiona/pool.hpp"
#include "group.hpp"
#include "model.hpp"
#include "package.hpp"
#include "types.hpp"
#include "waits.hpp"

namespace fiona::host {

/// A running system: instances in groups, and the wires between them. One model, changed by one thread.
class System {
 public:
  struct Options {
    std::string name;
    std::filesystem::path store;
    std::filesystem::path directory;  ///< for the sockets of links
    std::size_t threads = 0;
    /// Of the machine's time: how long virtual time may stand for the same reason before whoever waits is told.
    std::chrono::milliseconds standstill{5000};
  };
  /// [any thread] What happened in a group; watched values included.
  using OnEvent = std::function<void(const wire::GroupMessage&)>;

  System(Options options, OnEvent on_event);
  ~System();

  const Model& model() const { return model_; }
  const Packages& packages() const { return packages_; }

  /// Makes one change, other than of a mode, or throws Error and has changed nothing; the note is for people.
  control::Done perform(const control::Change& change);
  /// Answered when the change of mode has been made, or why not; throws Error if it cannot be.
  void state(std::uint64_t owner, std::uint64_t id, const control::State& request, Waits::Answer answer);
  /// A change of mode has been made: from now on it is what the system is meant to be.
  void note_state(const control::State& request);
  /// Uses a query or send port, or a trigger; answered with how it ended.
  void call(std::uint64_t owner, std::uint64_t id, const control::Call& request, Waits::Answer answer);

  control::System snapshot();
  const Types& types() const { return types_; }
  Waits& waits() { return *waits_; }

  /// Starts to deliver what a push port or a probe says, as Tapped events with this number of `new_tap`, until `untap`
  /// or TapEnded; a required port stands for its provider's.
  void tap(std::uint64_t tap, const control::Watch& request);
  std::uint64_t new_tap() { return next_tap_++; }
  void untap(std::uint64_t tap);
  /// The value of now of a probe; its type is empty while it has none.
  wire::Tapped read(const control::PortName& probe);
  /// What INSTANCE.NAME.FIELD names, which may be a probe of the hull: `nav.location.rate`.
  control::Expect expected(control::Expect request);
  bool has_instance(const std::string& name) const { return model_.find(name) != nullptr; }
  /// Whether the instance is in this mode already, and the mode it is in.
  std::pair<bool, std::string> has_mode(const std::string& instance, const std::string& mode);

  Clock& clock() { return *clock_; }
  /// While virtual time is held: waits until all processes have done what they were told, so that the next line finds
  /// the same state each time. Bounded by `standstill`.
  void settle();
  /// Call it at least once a second while the clock is virtual: ends all waits with an error that names what runs when
  /// virtual time has stood too long.
  void watch_time();
  bool has_virtual_clock() const { return virtual_ != nullptr; }
  /// The groups that are child processes: poll their descriptors, call `serve_group` when readable.
  std::vector<ChildGroup*> child_groups();
  void serve_group(ChildGroup& group);  ///< passes on what it has said; notes its end
  /// A wire has been lost on its client's side.
  void on_wire_lost(std::uint64_t wire, const std::string& reason);

 private:
  /// A wire as it is; the model says what it is meant to be.
  struct Wire {
    std::uint64_t id = 0;  ///< 0: it waits for its provider
    bool local = false;
    std::string reason;  ///< why it waits, or was lost
  };

  control::Done load(const control::Load& request, const Model& next);
  control::Done unload(const control::Unload& request);
  control::Done wire(const control::Wire& request, const Model& next);
  control::Done unwire(const control::Unwire& request);
  control::Done set(const control::Set& request, const Model& next);

  Group& group(const std::string& name);
  /// Of an instance that lives; throws Error Unreachable otherwise.
  Group& group_of(const std::string& instance, const Model& model);
  void retire_if_empty(const Group& target);
  void lose(ChildGroup& gone);
  std::vector<control::InstanceStatus> status_of_group(Group& target, control::LinkStatus& links);
  Wire connect(const control::PortName& client, const Model& model, std::uint64_t replaces, control::Done& done);
  void disconnect(const control::PortName& client, const Wire& wire, const std::string& reason);
  void await_provider(const control::PortName& client, const std::string& reason, const Model& model);
  std::string connect_waiting(const std::string& provider, const Model& next);
  control::PortName callee(const control::PortName& name);
  void use_clock(std::unique_ptr<Clock> clock);
  void record_to(std::shared_ptr<DeliveryLog> log);
  std::uint64_t progress() const;
  Error standstill() const;
  void end_threads();
  control::InstanceStatus status_of_lost(const std::string& name) const;
  void complete_status(control::InstanceStatus& status) const;
  void deliver(const wire::GroupMessage& event);

  const Options options_;
  const OnEvent on_event_;
  const Packages packages_;
  Types types_;
  Model model_;
  PluginLibraries libraries_;  ///< of `main`; kept when the clock changes
  std::unique_ptr<Clock> clock_;
  VirtualClock* virtual_ = nullptr;  ///< the clock, if it is one
  std::unique_ptr<ClockMaster> master_;  ///< of a virtual clock
  std::shared_ptr<DeliveryLog> deliveries_;
  /// Since when virtual time stands at this progress, by the machine's clock.
  struct Standing {
    std::uint64_t progress = 0;
    std::chrono::steady_clock::time_point since{};
    bool asked = false;
  };
  Standing standing_;
  std::optional<std::uint64_t> unsettled_;  ///< the progress at which `settle` gave up
  std::unique_ptr<Pool> pool_;  ///< ends before the clock that its strands live by
  std::unique_ptr<Waits> waits_;
  std::map<std::string, std::unique_ptr<Group>> groups_;
  std::map<std::string, std::string> lost_;  ///< instances whose group is gone, and why
  std::map<Model::PortKey, Wire> wires_;     ///< by the client's port
  std::map<std::uint64_t, std::string> taps_;                  ///< tap -> group
  std::set<std::string> noted_dead_;  ///< endpoints of groups whose end has been dealt with
  std::uint64_t next_wire_ = 1;
  std::uint64_t next_tap_ = 1;
  std::uint64_t next_work_ = 1;
  std::uint64_t next_order_ = 1;
};

}  // namespace fiona::host
