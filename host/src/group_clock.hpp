#pragma once

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "fiona/clock.hpp"
#include "fiona/wire.pb.h"
#include "link_socket.hpp"
#include "os/message_stream.hpp"

namespace fiona::host {

/// The virtual clock of a group. It does not decide when time goes on: it tells the host's clock whenever nothing runs
/// here, and does each round when it is told to.
class GroupClock final : public VirtualClock {
 public:
  using Frames = std::function<std::map<std::string, FrameCounts>()>;

  /// `socket`: to the host's ClockMaster, whose clock starts at `start`.
  GroupClock(os::Descriptor socket, TimePoint start);
  ~GroupClock() override;
  void stop() override;

  /// [once, at the beginning] Follows the host from now on; `frames` counts what goes over this process's links.
  void follow(Frames frames);
  /// [control thread] Around a request of the host, which it made at `now`.
  void begin_request(TimePoint now);
  void end_request(std::uint64_t id);
  /// [any thread] Before an event is handed to the host.
  void count_event() { ++events_; }

 private:
  class Lines;

  bool next_round(Lock& lock) override;
  bool take_step(Lock& lock);
  void report(Lock& lock);
  void send(const wire::ClockReport& report);
  void send_lines();
  void serve();

  os::MessageStream stream_;
  std::mutex send_mutex_;
  std::atomic<std::uint64_t> events_{0};
  std::atomic<std::uint64_t> request_{0};
  std::thread reader_;

  // of the thread that proceeds, or under the clock's lock
  Frames frames_;
  std::optional<wire::ClockStep> step_;  ///< told, and not yet done
  std::uint64_t done_step_ = 0;
  std::shared_ptr<Lines> lines_;
  std::string last_report_;
};

}  // namespace fiona::host
