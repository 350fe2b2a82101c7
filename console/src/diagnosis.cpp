#include "diagnosis.hpp"

#include <algorithm>
#include <optional>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <fiona/error.hpp>

#include "system_view.hpp"

namespace fiona::console {
namespace {

bool is_push(const control::PortStatus& port) {
  return port.pattern() == fiona::PUSH_NEWEST || port.pattern() == fiona::PUSH_TIMED;
}

/// A restart, or a refusal, of which the system may not have recovered.
constexpr double kRestartedLately_s = 60;
constexpr double kRefusedLately_ms = 10'000;

/// Of a provided port: longer than its lease allows. One that may be silent for ever is told only if it has never
/// spoken.
bool is_silent(const control::PortStatus& port) {
  return is_push(port) && (port.lease_ms() > 0 ? port.silent() : port.age_ms() < 0);
}

/// What the port puts breaks its rules, now and then or always.
bool is_refused(const control::PortStatus& port) {
  if (!is_push(port) || port.refusal().empty()) return false;
  const bool since_it_spoke = port.age_ms() < 0 || port.refusal_age_ms() < port.age_ms();
  return port.refusal_age_ms() < kRefusedLately_ms || (is_silent(port) && since_it_spoke);
}

/// For how long a client has got nothing.
double without_s(const control::PortStatus& client) {
  return client.age_ms() < 0 ? client.since_s() : client.age_ms() / 1000;
}

/// Of a client: what it has got is older than what its provider has said by more than the lease.
bool misses_what_is_said(const control::PortStatus& client, const control::PortStatus& provided) {
  if (provided.age_ms() < 0 || (provided.lease_ms() <= 0 && client.age_ms() >= 0)) return false;
  const double behind_ms = 1000 * without_s(client) - provided.age_ms();
  return behind_ms > provided.lease_ms() * std::max(1U, client.prescale());
}

std::string refused_text(const control::PortStatus& port) {
  const std::string rule = port.refusal().empty() ? "a rule of size, range or finiteness" : "a rule";
  return fmt::format("{} broke {}{}{}", port.refused(), rule,
                     port.refusal().empty() ? "" : ", the last: ", port.refusal());
}

bool is_late(const control::PortStatus& port) { return port.lease_ms() > 0 && port.latency_p99_ms() > port.lease_ms(); }

bool works(const control::InstanceStatus& instance) {
  const auto& modes = instance.modes();
  return instance.silent_s() <= 0 && std::find(modes.begin(), modes.end(), instance.mode()) != modes.end();
}

/// Follows what an instance needs to where the trouble begins. What has been visited is not followed again, so that a
/// circle of wires ends.
class Diagnosis {
 public:
  explicit Diagnosis(const control::System& system) : system_(system) {}

  void look_at(const control::InstanceStatus& instance) {
    if (!visited_.insert(instance.name()).second) return;
    if (add_own_trouble(instance)) return;
    for (const auto& port : instance.ports()) {
      if (port.direction() == fiona::PROVIDES && is_refused(port)) look_at(instance, port);
    }
    look_at_inputs(instance);
    for (const auto& port : instance.ports()) {
      if (port.direction() == fiona::PROVIDES && !port.clients().empty()) look_at(instance, port);
    }
  }

  void look_at(const control::InstanceStatus& instance, const control::PortStatus& port) {
    if (!visited_.insert(instance.name() + "." + port.name()).second) return;
    port.direction() == fiona::PROVIDES ? look_at_provided(instance, port) : look_at_required(instance, port);
  }

  std::vector<Finding> take() { return std::move(found_); }

 private:
  void add(std::string thing, std::string state, double since_s = -1, std::string next = {}) {
    found_.push_back({std::move(thing), std::move(state), since_s, std::move(next)});
  }

  /// Whether the instance itself does not work; then its inputs do not matter.
  bool add_own_trouble(const control::InstanceStatus& instance) {
    const std::string& name = instance.name();
    if (!told_.insert(name).second) return !works(instance) || instance.has_pending();
    const auto& modes = instance.modes();
    if (instance.silent_s() > 0) {
      add(name, "silent: " + instance.reason(), instance.silent_s(), "ls hosts");
    } else if (instance.mode() == "failed") {
      add(name, "failed: " + instance.reason(), instance.mode_since_s(), "show " + name);
    } else if (instance.has_pending()) {
      add(name, fmt::format("is to be {}, and waits for {}", instance.pending().to(), instance.pending().blocked_by()),
          instance.pending().blocked_s(), "show " + name);
    } else if (!works(instance)) {
      const std::string line = modes.empty() ? "" : fmt::format("state {} {}", name, modes.at(0));
      add(name, "is " + instance.mode(), instance.mode_since_s(), line);
    } else {
      if (!instance.restart_reason().empty() && instance.restarted_s() < kRestartedLately_s)
        add(name, fmt::format("was restarted {}x: {}", instance.restarts(), instance.restart_reason()),
            instance.restarted_s(), "show " + name);
      return false;
    }
    return true;
  }

  void look_at_inputs(const control::InstanceStatus& instance) {
    for (const auto& port : instance.ports()) {
      const bool wanted = !port.optional() || port.connection() != control::UNWIRED;
      if (port.direction() == fiona::REQUIRES && wanted) look_at(instance, port);
    }
  }

  void look_at_provided(const control::InstanceStatus& instance, const control::PortStatus& port) {
    const std::string name = instance.name() + "." + port.name();
    if (add_own_trouble(instance)) {
      if (is_push(port)) add(name, "is silent", port.age_ms() / 1000);
      return;
    }
    if (const auto modes = modes_that_serve(instance, port)) {
      return add(
          name, fmt::format("works in {}, and {} is {}", fmt::join(*modes, ", "), instance.name(), instance.mode()),
          instance.mode_since_s(), modes->empty() ? "" : fmt::format("state {} {}", instance.name(), modes->front()));
    }
    if (is_refused(port)) {
      add(name, "is refused: " + refused_text(port), port.refusal_age_ms() / 1000, "show " + name);
      return look_at_inputs(instance);
    }
    if (!is_silent(port)) return;
    const std::size_t before = found_.size();
    look_at_inputs(instance);
    const bool by_itself = found_.size() == before;
    const std::string state = port.age_ms() < 0 ? "has not said anything yet" : "is silent";
    const double since_s = port.age_ms() < 0 ? instance.mode_since_s() : port.age_ms() / 1000;
    if (!by_itself) return add(name, state, since_s);
    add(name, fmt::format("{}, though {} gets all that it requires{}", state, instance.name(), work_text(instance)),
        since_s, "show " + instance.name());
  }

  void look_at_required(const control::InstanceStatus& instance, const control::PortStatus& port) {
    const std::string name = instance.name() + "." + port.name();
    if (port.connection() == control::UNWIRED) return add(name, "is not wired", port.since_s(), "spots");
    const control::InstanceStatus* provider = find_instance(system_, port.peer().instance());
    const control::PortStatus* provided = provider == nullptr ? nullptr : find_port(*provider, port.peer().port());
    if (provider == nullptr && port.connection() == control::WAITING)
      add(port.peer().instance(), "is not loaded", -1, near_line(port.peer().instance()));
    for (const auto& one : port.providers()) look_at_alternative(one);
    if (provided != nullptr) look_at(*provider, *provided);
    if (port.connection() != control::CONNECTED) return add(name, "is " + connection_text(port), port.since_s());
    if (provided != nullptr && is_push(port)) look_at_arrivals(instance, port, *provider, *provided);
  }

  /// Of a port with several: whoever is not fit.
  void look_at_alternative(const control::ProviderStatus& one) {
    const control::InstanceStatus* provider = find_instance(system_, one.provider().instance());
    const control::PortStatus* provided = provider == nullptr ? nullptr : find_port(*provider, one.provider().port());
    if (one.fit()) return;
    if (provided != nullptr) look_at(*provider, *provided);
    add(text_of(one.provider()), "is an alternative that cannot serve: " + one.reason());
  }

  /// The wire is there: whether what comes is taken, and in time.
  void look_at_arrivals(const control::InstanceStatus& instance, const control::PortStatus& port,
                        const control::InstanceStatus& provider, const control::PortStatus& provided) {
    const std::string name = instance.name() + "." + port.name();
    if (is_silent(provided) || !works(provider)) return add(name, "gets nothing", without_s(port));
    if (misses_what_is_said(port, provided)) {
      std::vector<std::string> why;
      if (port.refused() > 0) why.push_back(refused_text(port));
      if (port.dropped() > 0) why.push_back(fmt::format("{} were dropped", port.dropped()));
      if (port.not_active() > 0)
        why.push_back(fmt::format("{} came in a mode that does not take them", port.not_active()));
      if (instance.queue_depth() > 0)
        why.push_back(fmt::format("{} wait in the queue of {}", instance.queue_depth(), instance.name()));
      add(name,
          fmt::format("takes nothing of what its provider says{}{}", why.empty() ? "" : ": ", fmt::join(why, ", ")),
          without_s(port), "show " + name);
    } else if (is_late(port)) {
      add(name,
          fmt::format("is late: one in a hundred is under way for {}, and {} is loss{}",
                      age_text(port.latency_p99_ms()), age_text(port.lease_ms()), work_text(instance)),
          -1, "show " + instance.name());
    }
  }

  /// The modes in which the port works, where the instance's is none of them.
  std::optional<std::vector<std::string>> modes_that_serve(const control::InstanceStatus& instance,
                                                           const control::PortStatus& port) const {
    if (port.activity().empty()) return std::nullopt;
    std::vector<std::string> serve;
    for (const auto& interface : system_.interfaces()) {
      for (const auto& component : interface.components()) {
        if (component.name() != instance.component()) continue;
        for (const auto& mode : component.modes()) {
          const auto& activities = mode.activities();
          if (std::find(activities.begin(), activities.end(), port.activity()) != activities.end())
            serve.push_back(mode.name());
        }
      }
    }
    const bool serves = serve.empty() || std::find(serve.begin(), serve.end(), instance.mode()) != serve.end();
    return serves ? std::nullopt : std::optional(serve);
  }

  /// "; task 'fuse' has overrun 12 times; 40 messages wait": what keeps it from its work, if anything does.
  static std::string work_text(const control::InstanceStatus& instance) {
    std::string text;
    for (const auto& task : instance.tasks()) {
      if (task.overruns() > 0)
        text += fmt::format("; task '{}' has overrun {} times", task.task().name(), task.overruns());
    }
    if (instance.queue_depth() > 0) text += fmt::format("; {} messages wait for it", instance.queue_depth());
    return text;
  }

  std::string near_line(const std::string& missing) const {
    const auto near = nearest_names(missing, instance_names(system_));
    return near.empty() ? fmt::format("load PLUGIN as {}", missing) : fmt::format("did you mean {}?", near.front());
  }

  const control::System& system_;
  std::set<std::string> visited_;
  std::set<std::string> told_;  ///< instances whose own trouble has been told
  std::vector<Finding> found_;
};

}  // namespace

std::vector<Finding> findings_of(const control::System& system, const control::InstanceStatus& instance) {
  Diagnosis diagnosis(system);
  diagnosis.look_at(instance);
  return diagnosis.take();
}

std::vector<Finding> findings_of(const control::System& system, const control::InstanceStatus& instance,
                                 const control::PortStatus& port) {
  Diagnosis diagnosis(system);
  diagnosis.look_at(instance, port);
  return diagnosis.take();
}

}  // namespace fiona::console
