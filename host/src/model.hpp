#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "clock_settings.hpp"
#include "fiona/control.pb.h"
#include "fiona/message.hpp"
#include "names.hpp"
#include "package.hpp"

namespace fiona::host {

/// A name that can be typed in one word, in any script, and has no meaning of its own; throws Error Usage otherwise.
void require_name(const std::string& name, std::string_view kind);

/// A system as it is meant to be: what was asked for, not how the instances are doing. A value: cheap to copy, so that
/// a change is tried on a copy before anything is touched.
class Model {
 public:
  struct Instance {
    std::string plugin;  ///< as `load` named it
    std::shared_ptr<const Package> package;
    std::string component;
    std::string group;
    std::string mode;                          ///< as last asked for
    std::string mode_at_load;                  ///< as `load` asked; empty: the first
    std::shared_ptr<const Object> parameters;  ///< null: the component has none
    std::uint64_t order = 0;                   ///< of loading
    std::vector<std::string> rights{};         ///< that it was granted
    std::string comment{};                     ///< of its system file
    bool led = false;                          ///< of the system of the host that leads this one

    const ComponentInterface& interface() const { return package->component(component); }
    /// Whether it may change the system that it is part of.
    bool is_master() const { return std::find(rights.begin(), rights.end(), "master") != rights.end(); }
    /// What finds its package, and its component in it.
    std::string source() const;
    /// Whether this is the mode that it is meant to be in; deactivated it is neutral, too.
    bool is_in(std::string_view now) const;
    /// The mode that loading it brings it to.
    std::string mode_after_load() const;
    /// Null: the component has none.
    std::shared_ptr<Object> empty_parameters() const;
    std::shared_ptr<Object> default_parameters() const;
  };
  struct Wire {
    std::vector<control::PortName> providers{};  ///< the first, and its alternatives in their order
    std::uint32_t prescale = 1;
    double hold_ms = kHold_ms;  ///< before a better provider serves again
    static constexpr double kHold_ms = 3000;

    bool uses(const std::string& instance) const;
    bool operator==(const Wire& other) const;
    Wire with_prescale(std::uint32_t other) const {
      Wire changed = *this;
      changed.prescale = other;
      return changed;
    }
    /// What makes it so. `before`: the client's wire until then; null: none.
    control::Change change_for(const PortKey& client, const Wire* before) const;
  };

  const Instance* find(const std::string& name) const;
  std::vector<std::string> names() const;
  /// Those in this group.
  std::vector<std::string> names_in(const std::string& group) const;
  /// Throws Error NotFound with the nearest names.
  const Instance& instance(const std::string& name) const;
  /// The port of an instance. Throws Error: no such instance or port, or one of the other direction.
  const PortInterface& port(const control::PortName& name, Direction direction) const;
  const Wire* wire_of(const control::PortName& client) const;
  /// By the client's port.
  const std::map<PortKey, Wire>& wires() const { return wires_; }
  const ClockSettings& clock() const { return clock_; }

  /// Makes the change in the model. Throws Error, and changes nothing, when it cannot be: everything that can be told
  /// without running a component is told here.
  void make(const control::Change& change, const Packages& packages);
  /// An instance that the host that leads this one has here. It belongs to no change of this system.
  void take(const std::string& name, Instance instance);
  void drop(const std::string& name) { instances_.erase(name); }
  /// Who leads now, and alone may change what is its; empty: nobody.
  void set_leader(std::string leader) { leader_ = std::move(leader); }
  /// Throws Error NotAllowed for what is the leader's, or that of one that has gone; its own may be unloaded then.
  void require_own(const std::string& name, bool to_unload = false) const;
  /// What loads an instance as it is meant to be now.
  control::Load load_of(const std::string& name) const;
  /// The change as steps that each do one thing: a swap as its wires.
  std::vector<control::Change> steps_of(const control::Change& change) const;
  /// Another version of its package takes the place of an instance, in this group. Throws Error, and changes nothing,
  /// where it does not fit who uses it and whom it uses, its mode or its parameters.
  void upgrade(const std::string& name, std::shared_ptr<const Package> package, const std::string& group);
  /// The ports that clients would be moved from by a swap, each with the one that takes its place.
  std::vector<std::pair<control::PortName, control::PortName>> replaced_by(const control::Replace& swap) const;
  /// The provider's port fits the client's; throws Error WiringInvalid naming both services and who would fit.
  void require_fit(const control::PortName& client, const control::PortName& provider) const;
  /// Whether an instance that is here could not be loaded while the client has this wire, which waits for its name.
  bool keeps_out(const PortKey& client, const Wire& wire) const;

  /// The fewest steps that lead from one system to another, in an order in which they can be made.
  static std::vector<control::Change> difference(const Model& from, const Model& to);

 private:
  void load(const control::Load& request, const Packages& packages);
  void unload(const control::Unload& request);
  void wire(const control::Wire& request);
  void unwire(const control::Unwire& request);
  void set(const control::Set& request);
  void set_host(const control::Set& request);
  void state(const control::State& request);
  void require_waiting_fit(const std::string& name) const;
  void require_wires_fit(const std::string& name) const;
  std::string providers_of(const std::string& service) const;
  control::PortName counterpart(const control::PortName& provider, const std::string& next) const;

  std::map<std::string, std::shared_ptr<const Instance>> instances_;
  std::map<PortKey, Wire> wires_;
  std::string leader_;
  ClockSettings clock_;
  std::uint64_t next_order_ = 1;
};

}  // namespace fiona::host
