#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "fiona/control.pb.h"
#include "fiona/marketplace/store.hpp"
#include "fiona/pool.hpp"
#include "group.hpp"
#include "host_links.hpp"
#include "remote_group.hpp"
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
    HostOptions hosts{};              ///< over tcp; by default none
    std::filesystem::path plugins{};  ///< libraries that a leading host may have loaded though they are in no package
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
  /// The groups that are child processes: poll their descriptors, call `serve_group` when readable.
  std::vector<ChildGroup*> child_groups();
  void serve_group(ChildGroup& group);  ///< passes on what it has said; notes its end
  /// A wire has been lost on its client's side.
  void on_wire_lost(std::uint64_t wire, const std::string& reason);

  /// Readable when something has happened between hosts, then call `serve_hosts`; -1 without tcp.
  int hosts_descriptor() const { return hosts_ ? hosts_->descriptor() : -1; }
  /// What there is to tell people, line by line.
  std::vector<std::string> serve_hosts();
  /// Where it listens for a host that leads; empty: nowhere.
  std::string listens() const { return hosts_ && hosts_->leader() ? hosts_->leader()->address() : ""; }

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
    bool away = false;  ///< lost because its host is silent: it may come back
    bool led = false;   ///< another host's system has it
  };
  struct Wire {
    std::uint64_t id = 0;
    control::PortName provider;
    std::uint32_t prescale = 1;
    bool local = false;
    std::string lost;
    std::vector<std::string> relays{};  ///< groups that pass it on
  };
  struct PortRef {
    const Instance* instance;
    const PortInterface* port;
  };

  Installed find_plugin(const std::string& text) const;
  Installed find_library(const std::filesystem::path& library) const;
  static std::string choose_component(const Interface& interface, const std::string& plugin, const std::string& wanted);
  /// `led`: for the host that leads this one.
  std::string create(Installed package, const control::Load& request, bool led);
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
               std::uint64_t replaces, bool resumes = false);
  void disconnect(const control::PortName& client, const Wire& wire, const std::string& reason);
  control::PortName callee(const control::PortName& name);
  void set_host(const control::Set& request);
  void use_clock(std::unique_ptr<Clock> clock);
  void end_threads();
  control::InstanceStatus status_of_lost(const std::string& name, const Instance& instance) const;
  void complete_status(control::InstanceStatus& status) const;
  void deliver(const wire::GroupMessage& event);

  // ---- with other hosts (system_hosts.cpp)
  std::string host_of(const std::string& group) const;
  Group& main_of(const std::string& host);
  Group* remote_group(const std::string& name);
  std::vector<RemoteGroup*> groups_of(const std::string& host);
  RemoteGroup* silent_group(const Instance& one);
  std::string route(Wire& wire, const std::string& token, Group& client, Group& provider);
  void cut_at(const std::string& group, std::uint64_t wire, const std::string& reason);
  bool crosses(const control::PortName& client, const Wire& wire, const std::string& host);
  std::string on_host_joined(const HostChange& change);
  void on_host_lost(const std::string& host, const std::string& reason, bool for_good);
  void resume(RemoteGroup& group);
  void resume_wires(const std::string& host);
  void on_remote_group_ended(const HostChange& change);
  wire::GroupMessage obey(const wire::HostRequest& order);
  void obey_create(const wire::GroupRequest& request, const std::string& group, wire::GroupMessage& reply);
  void check_order(const wire::GroupRequest& request);
  std::string led_endpoint(const std::string& endpoint);
  Instance& led_instance(const std::string& name);
  void keep_led(wire::GroupStatusReply& status) const;
  void drop_led();
  void note_led(const std::string& instance, bool led);
  bool tell_leader(const wire::GroupMessage& event);
  void refuse_if_led(const std::string& instance);
  void add_hosts(control::System& all);
  const char* transport(const std::string& client, const Wire& wire) const;

  const Options options_;
  const OnEvent on_event_;
  marketplace::Store store_;
  Types types_;
  PluginLibraries libraries_;  ///< of `main`; kept when the clock changes
  std::unique_ptr<Clock> clock_;
  std::unique_ptr<Pool> pool_;  ///< ends before the clock that its strands live by
  std::unique_ptr<Waits> waits_;
  std::map<std::string, std::unique_ptr<Group>> groups_;
  std::map<std::string, Instance> instances_;
  std::map<std::pair<std::string, std::string>, Wire> wires_;  ///< by client instance and port
  std::map<std::uint64_t, std::string> taps_;                  ///< tap -> group
  std::set<std::string> noted_dead_;  ///< endpoints of groups whose end has been dealt with
  // A host that is led has numbers of its own from `kOwnNumbers`; those of its leader are below.
  static constexpr std::uint64_t kOwnNumbers = 1ULL << 40;
  std::uint64_t next_wire_ = 1;
  std::uint64_t next_tap_ = 1;
  std::uint64_t next_work_ = 1;
  std::uint64_t next_order_ = 1;
  std::unique_ptr<HostLinks> hosts_;     ///< none: no tcp
  std::mutex led_mutex_;
  std::set<std::string> led_names_;      ///< guarded by led_mutex_: instances of the leader's system
  std::set<std::uint64_t> led_relays_;   ///< wires of the leader's system that are passed on here
};

}  // namespace fiona::host
