#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <set>
#include <string>

#include "groups.hpp"
#include "model.hpp"
#include "package.hpp"

namespace fiona::host {

/// What the host that leads this one has here (docs/hosts.md): instances of its own system, made, wired and destroyed
/// by its orders. An order reaches those, their wires and their taps, and nothing else of this host.
class LedInstances {
 public:
  /// A host that is led has numbers of wires, taps and work of its own from here; those of its leader are below.
  static constexpr std::uint64_t kOwnNumbers = 1ULL << 40;

  struct Surroundings {
    std::string host;               ///< this one's name
    std::filesystem::path plugins;  ///< libraries that may be loaded though they are in no package; empty: none may
    const Packages& packages;
    const Model& model;
    Groups& groups;
    /// Makes the instance, and has the model `next` from then on; throws Error, and has changed nothing, if it cannot.
    std::function<void(Model next, const std::string& name, const control::Load& request)> make;
    /// Destroys the instance, and has it no more in the model. Returns what there is to say of it.
    std::function<std::string(const std::string& name)> destroy;
  };
  explicit LedInstances(Surroundings around) : around_(std::move(around)) {}

  /// [control thread] Does it; returns the answer, which may be why it was refused.
  wire::GroupMessage obey(const wire::HostRequest& order);
  /// [control thread] Destroys what a former leader has left; what does not end now, when `destroy_left` comes to it.
  void destroy_all();
  void destroy_left(std::chrono::steady_clock::time_point now);
  /// [control thread] It has gone, as the user of this host asked.
  void forget(const std::string& name);
  /// [control thread] It has gone with its group: the leader is told why when he asks what is here.
  void forget(const std::string& name, const std::string& reason);
  /// [any thread] Whether the event is of the system of the leader, who is to be told it then.
  bool is_of_leader(const wire::GroupMessage& event) const;

 private:
  void check(const wire::GroupRequest& request) const;
  void require_led(const std::string& name) const;
  void create(const wire::GroupRequest& request, const std::string& group, wire::GroupMessage& reply);
  Packages::Choice own_package(const wire::Create& create) const;
  wire::GroupMessage pass_on(wire::GroupRequest request, Group& group);
  Group& group_at(const std::string& endpoint) const;
  Links::Endpoint own_endpoint(const std::string& endpoint, const Group& at) const;
  void keep_led(wire::GroupStatusReply& status) const;
  void keep_led(wire::Adopted& held) const;
  std::string destroy(const std::string& name);
  void note(const std::string& name, bool led);
  bool is_led(const std::string& name) const;

  const Surroundings around_;
  mutable std::mutex mutex_;
  std::set<std::string> left_;  ///< by a former leader, and not destroyed
  std::chrono::steady_clock::time_point destroys_at_{};
  std::map<std::string, std::string> ended_;  ///< those that have gone with their group, and why
  std::set<std::string> names_;               ///< guarded by mutex_: the model is the control thread's
};

}  // namespace fiona::host
