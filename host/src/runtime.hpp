#pragma once

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "fiona/clock.hpp"
#include "fiona/hull.hpp"
#include "fiona/local_wire.hpp"
#include "fiona/pool.hpp"
#include "fiona/wire.pb.h"
#include "instance_events.hpp"
#include "links.hpp"
#include "plugin_library.hpp"
#include "taps.hpp"

namespace fiona::host {

/// How long a life-cycle call of a component may take before the host gives up on it.
inline constexpr Duration kLifeCycleDeadline = std::chrono::seconds(10);

/// What holds the instances of one process, in the host itself and in each of its groups alike. It knows nothing of
/// the system: it does what the host's requests say, and reports what happens.
class Runtime final {
 public:
  using OnEvent = InstanceEvents::OnEvent;

  /// Who ends this process when a component in it never comes to be.
  enum class Watched { ByItsHost, ByNobody };
  Runtime(Pool& pool, Clock& clock, PluginLibraries& libraries, std::string endpoint, LinkKeys keys, Watched watched,
          OnEvent on_event);
  ~Runtime();
  Runtime(const Runtime&) = delete;
  Runtime& operator=(const Runtime&) = delete;

  /// [control thread] Does what is asked. What cannot be done is in the message, as a Failure.
  wire::GroupMessage handle(const wire::GroupRequest& request);
  const std::string& endpoint() const { return links_.endpoint(); }
  /// [control thread] An instance does not come back from its work: it has failed, its wires are lost.
  void give_up(const std::string& instance, const std::string& reason);
  /// [control thread] Of instances that have failed since, too. Call it whenever an event has come: what has failed is
  /// found by that. Not on a virtual clock, where no instant belongs to it: who asks is told `not_active` in its turn.
  void let_failed_go();
  /// Whether the strand is of one that was destroyed and had not come free: whoever has its name now is another one.
  bool has_left(const Liveness::Slot* slot) const { return left_.contains(slot); }
  std::map<std::string, FrameCounts> frame_counts() { return links_.frame_counts(); }
  Links& links() { return links_; }
  /// [control thread] The host has gone, and `main` with it, which has listened there.
  void host_lost(const std::string& endpoint);

 private:
  struct Instance {
    std::string plugin;
    std::string version;
    std::string component;
    std::string doc;
    std::unique_ptr<Hull> hull;
    std::shared_ptr<std::atomic<bool>> hangs;  ///< it has been given up, and has not come back; shared with its strand
    bool let_go = false;                       ///< its wires are lost: it has failed

    /// How long its end may take.
    Duration patience() const { return hangs && *hangs ? Duration::zero() : kLifeCycleDeadline; }
  };
  /// A wire within this process.
  struct Wire {
    std::shared_ptr<LocalWire> local;
    detail::PushProvider* provider = nullptr;  ///< of a push
    std::shared_ptr<WireEnd> client;
    const Hull* provider_hull = nullptr;
    std::uint32_t prescale = 1;
  };
  class CallReply;

  void dispatch(const wire::GroupRequest& request, wire::GroupMessage& reply);
  Instance& find(const std::string& name);
  void emit(wire::GroupMessage message) { on_event_(std::move(message)); }

  // ---- runtime_instances.cpp
  void create(const wire::Create& request);
  void set_parameters(const wire::SetParameters& request);
  void set_mode(const wire::SetMode& request);
  Hull::ModeDone mode_set(std::uint64_t change);
  void destroy(const wire::Destroy& request, wire::GroupMessage& reply);
  void leave(std::unique_ptr<Hull> hull);
  void let_go(Instance& instance, const std::string& reason);

  // ---- runtime_wires.cpp
  void wire_local(const wire::WireLocal& request, wire::Switched& switched);
  void wire_provide(const wire::WireProvide& request);
  void set_prescale(const wire::SetPrescale& request);
  void wire_require(const wire::WireRequire& request, wire::Switched& switched);
  void wire_relay(const wire::WireRelay& request);
  void await(const wire::Await& request);
  void arrange(const wire::Arrange& request, wire::Switched& switched);
  void cut(const wire::Cut& request);
  void retire(std::uint64_t wire, bool drains = false);
  void end_wires(const Hull& hull, Connection now, const std::string& reason);
  ProvidedPort& provided(const control::PortName& name);
  template <class Port>
  static Port& living(Port& port, const control::PortName& name);
  RequiredPort& required(const control::PortName& name);

  // ---- runtime_calls.cpp
  void call(const wire::Call& request);
  void give_up_call(const wire::GiveUpCall& request);
  void call_port(const Hull& hull, const wire::Call& request, const std::shared_ptr<ReplySink>& reply);
  void answered(const wire::Answered& answer);

  // ---- runtime_adoption.cpp
  void tell_held(wire::Adopted& adopted);

  // ---- runtime_status.cpp
  void status(wire::GroupStatusReply& reply);
  static control::InstanceStatus status_of(const Instance& instance, TimePoint now);

  Pool& pool_;
  Clock& clock_;
  const Watched watched_;
  const OnEvent on_event_;
  InstanceEvents events_;
  PluginLibraries& libraries_;
  std::map<std::string, std::unique_ptr<Instance>> instances_;
  std::set<const Liveness::Slot*> left_;  ///< of strands that stay for ever, with what they hold
  std::map<std::uint64_t, Wire> wires_;
  std::vector<std::shared_ptr<LocalWire>> retired_;  ///< until nothing is open any more that was asked over them
  Taps taps_;
  std::map<std::uint64_t, std::weak_ptr<CallReply>> calls_;  ///< by hand, by run
  Links links_;
};

}  // namespace fiona::host
