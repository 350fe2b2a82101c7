#pragma once

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "fiona/clock.hpp"
#include "fiona/hull.hpp"
#include "fiona/pool.hpp"
#include "fiona/wire.pb.h"
#include "links.hpp"
#include "plugin_library.hpp"
#include "taps.hpp"

namespace fiona::host {

/// What holds the instances of one process, in the host itself and in each of its groups alike. It knows nothing of
/// the system: it does what the host's requests say, and reports what happens.
class Runtime final : private HullEvents {
 public:
  /// [any thread] An event; called on whichever thread saw it, and must not wait.
  using OnEvent = std::function<void(wire::GroupMessage)>;

  /// `link_key`: what other processes must prove to know, before anything they send is looked at.
  Runtime(Pool& pool, Clock& clock, PluginLibraries& libraries, std::string endpoint, std::string link_key, OnEvent on_event);
  ~Runtime() override;

  /// [control thread] Does what is asked. What cannot be done is in the message, as a Failure.
  wire::GroupMessage handle(const wire::GroupRequest& request);
  const std::string& endpoint() const { return links_.endpoint(); }
  std::map<std::string, FrameCounts> frame_counts() { return links_.frame_counts(); }
  Links& links() { return links_; }

 private:
  struct Instance;
  struct Wire;
  class CallReply;

  void dispatch(const wire::GroupRequest& request, wire::GroupMessage& reply);
  void create(const wire::Create& request);
  void destroy(const wire::Destroy& request, wire::GroupMessage& reply);
  void set_mode(const wire::SetMode& request);
  void wire_local(const wire::WireLocal& request, wire::Switched& switched);
  void arrange(const wire::Arrange& request, wire::Switched& switched);
  void cut(const wire::Cut& request);
  void retire(std::uint64_t wire);
  void call(const wire::Call& request);
  void call_port(const Hull& hull, const wire::Call& request, const std::shared_ptr<ReplySink>& reply);
  void status(wire::GroupStatusReply& reply);

  Instance& find(const std::string& name);
  ProvidedPort& provided(const control::PortName& name);
  RequiredPort& required(const control::PortName& name);
  void emit(wire::GroupMessage message) { on_event_(std::move(message)); }

  void mode_changed(const std::string& instance, const std::string& mode, const std::string& reason) override;
  void run_ended(const std::string& instance, int exit_code, const std::string& reason) override;
  void logged(const std::string& instance, LogLevel level, std::string_view text) override;

  Pool& pool_;
  Clock& clock_;
  const OnEvent on_event_;
  PluginLibraries& libraries_;
  std::map<std::string, std::unique_ptr<Instance>> instances_;
  std::map<std::uint64_t, Wire> wires_;
  std::vector<std::weak_ptr<LocalWire>> retired_;  ///< of requests that were on their way at a rewire
  Taps taps_;
  Links links_;
};

control::Failure failure_of(const Error& error);
/// The exception being handled, as a Failure. Call inside a catch block.
control::Failure failure_of_exception();
/// The other way round. [[noreturn]]
[[noreturn]] void throw_failure(const control::Failure& failure);

}  // namespace fiona::host
