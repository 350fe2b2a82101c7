#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include "fiona/hull.hpp"
#include "fiona/wire.pb.h"
#include "mailbox.hpp"
#include "os/message_stream.hpp"

namespace fiona::host {

/// Bytes of an object that goes to the host and to a console: what a message may have, but for what comes along.
inline constexpr std::size_t kMostCopied = os::MessageStream::kMaxMessage - (1U << 20U);

/// What is watched of the instances of one process: each value goes to the host as an event.
class Taps {
 public:
  /// Of one port or probe: each copies what it sees in the component's own work.
  static constexpr std::size_t kMostOfOne = 32;

  /// [any thread] Must not wait.
  using OnEvent = std::function<void(wire::GroupMessage)>;

  explicit Taps(const OnEvent& on_event) : on_event_(on_event) {}

  // All [control thread].
  /// Throws Error: there is nothing of this name to see, or it is watched too often.
  void tap(const wire::Tap& request, Hull& hull);
  void untap(std::uint64_t tap);
  /// Nobody listens any more.
  void clear();
  /// The hull is about to end; whoever watches it is told by it.
  void release(const Hull& hull);

 private:
  class Teller;
  struct Open {
    Hull* hull = nullptr;
    std::string name{};
    std::shared_ptr<Tap> tap{};
    bool is_own = false;  ///< the host's
  };

  const OnEvent& on_event_;
  std::map<std::uint64_t, Open> taps_;
};

/// What is watched may be dropped where too much waits, but neither the newest of a tap nor its end behind that.
void push_event(Mailbox<wire::GroupMessage>& events, wire::GroupMessage event);
/// The value of now of a probe, as a tap would tell it.
wire::Tapped read_probe(const Hull& hull, const std::string& name);
/// The probes that the component declares, with their values.
void fill_probes(control::InstanceStatus& status, const Hull& hull, TimePoint now);

}  // namespace fiona::host
