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
#include "fiona/marketplace/store.hpp"
#include "clock_master.hpp"
#include "delivery_log.hpp"
#include "fiona/pool.hpp"
#include "group.hpp"
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

  // Each does its change or throws Error and changes nothing; the text is a note for people.
  std::string load(const control::Load& request);
  std::string unload(const control::Unload& request);
  std::string wire(const control::Wire& request);
  std::string unwire(const control::Unwire& request);
  std::string set(const control::Set& request);
  /// Answered when the change of mode has been made, or why not; throws Error if it cannot be.
  void state(std::uint64_t owner, std::uint64_t id, const control::State& request, Waits::Answer answer);
  /// Uses a query or send port, or a trigger; answered with how it ended.
  void call(std::uint64_t owner, std::uint64_t id, const control::Call& request, Waits::Answer answer);

  control::System snapshot();
  const Types& types() const { return types_; }
  Waits& waits() { return *waits_; }

  /// Starts to deliver what a push port puts, as Tapped events; a required port stands for its provider's.
  std::uint64_t tap(const control::PortName& port);
  void untap(std::uint64_t tap);
  bool has_instance(const std::string& name) const { return instances_.contains(name); }
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
  struct Installed {
    std::string name;  ///< "publisher/name"
    std::string version;
    std::filesystem::path library;
    std::filesystem::path share;
    Interface interface;
    std::string component;
    std::shared_ptr<marketplace::PackageHold> hold;
  };
  struct Instance {
    Installed package;
    std::string group;
    std::string lost;  ///< why its group is gone; empty: alive
    std::uint64_t order = 0;
  };
  struct Wire {
    std::uint64_t id = 0;
    control::PortName provider;
    std::uint32_t prescale = 1;
    bool local = false;
    std::string lost;
  };
  struct PortRef {
    const Instance* instance;
    const PortInterface* port;
  };

  Installed find_plugin(const std::string& text) const;
  Installed find_library(const std::filesystem::path& library) const;
  static std::string choose_component(const Interface& interface, const std::string& plugin, const std::string& wanted);
  Group& group(const std::string& name);
  void retire_if_empty(const Group& target);
  void lose(ChildGroup& gone);
  std::vector<control::InstanceStatus> status_of_group(Group& target);
  Instance& instance(const std::string& name);
  std::vector<std::string> instance_names() const;
  PortRef port(const control::PortName& name, Direction direction);
  void check_contract(const control::PortName& client, const control::PortName& provider);
  std::string providers_of(const std::string& service) const;
  Wire connect(const control::PortName& client, const control::PortName& provider, std::uint32_t prescale,
               std::uint64_t replaces);
  void disconnect(const control::PortName& client, const Wire& wire, const std::string& reason);
  control::PortName callee(const control::PortName& name);
  void set_host(const control::Set& request);
  void use_clock(std::unique_ptr<Clock> clock);
  void record_to(std::shared_ptr<DeliveryLog> log);
  std::uint64_t progress() const;
  Error standstill() const;
  void end_threads();
  control::InstanceStatus status_of_lost(const std::string& name, const Instance& instance) const;
  void complete_status(control::InstanceStatus& status) const;
  void deliver(const wire::GroupMessage& event);

  const Options options_;
  const OnEvent on_event_;
  marketplace::Store store_;
  Types types_;
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
  std::map<std::string, Instance> instances_;
  std::map<std::pair<std::string, std::string>, Wire> wires_;  ///< by client instance and port
  std::map<std::uint64_t, std::string> taps_;                  ///< tap -> group
  std::set<std::string> noted_dead_;  ///< endpoints of groups whose end has been dealt with
  std::uint64_t next_wire_ = 1;
  std::uint64_t next_tap_ = 1;
  std::uint64_t next_work_ = 1;
  std::uint64_t next_order_ = 1;
};

}  // namespace fiona::host
