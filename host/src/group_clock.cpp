#include "group_clock.hpp"

#include <utility>

namespace fiona::host {
namespace {

/// Of one message to the host, which takes 16 MiB: wire names have at most 300 characters.
constexpr int kLinesPerMessage = 10'000;
/// The stream is looked at again after so long though nothing came.
constexpr std::chrono::seconds kLook{60};

}  // namespace

/// What has been delivered since the last report. Used by the thread that proceeds alone.
class GroupClock::Lines final : public DeliveryRecorder {
 public:
  void delivered(TimePoint, std::string_view wire, std::uint64_t sequence, std::string_view what) override {
    auto& line = *lines.add_delivered();
    line.set_wire(std::string(wire));
    line.set_sequence(sequence);
    line.set_what(std::string(what));
  }
  wire::ClockReport lines;
};

GroupClock::GroupClock(os::Descriptor socket, TimePoint start)
    : VirtualClock(start), stream_(std::move(socket)), lines_(std::make_shared<Lines>()) {
  shared_ = true;
}

GroupClock::~GroupClock() { GroupClock::stop(); }

void GroupClock::stop() {
  stream_.shut_down();
  if (reader_.joinable()) reader_.join();
  VirtualClock::stop();
}

void GroupClock::follow(Frames frames) {
  {
    const std::lock_guard lock(mutex_);
    frames_ = std::move(frames);
  }
  reader_ = std::thread([this] { serve(); });
  reconsider();
}

void GroupClock::serve() {
  wire::ClockStep step;
  while (true) {
    while (stream_.next(step)) {
      if (step.step() == 0) {
        wire::ClockReport running;
        running.set_busy(true);
        for (auto& name : busy_strands()) running.add_running(std::move(name));
        send(running);
        continue;
      }
      {
        const std::lock_guard lock(mutex_);
        step_ = step;
      }
      reconsider();
    }
    stream_.wait_readable(std::chrono::steady_clock::now() + kLook);
    if (!stream_.receive()) return;
  }
}

void GroupClock::begin_request(TimePoint now) {
  const std::lock_guard lock(mutex_);
  advance_to(now);
}

void GroupClock::end_request(std::uint64_t id) {
  request_ = id;
  reconsider();
}

bool GroupClock::next_round(Lock& lock) {
  if (step_) return take_step(lock);
  if (frames_) report(lock);
  return false;
}

bool GroupClock::take_step(Lock& lock) {
  const wire::ClockStep step = *std::exchange(step_, std::nullopt);
  const TimePoint at{Duration(step.now_ns())};
  done_step_ = step.step();
  advance_to(at);
  recorder_ = step.record() ? lines_ : nullptr;
  return step.deliver() > 0 ? deliver_staged(lock, step.deliver()) : fire_timers(lock, at);
}

/// What came over a link is counted once it is staged, and what a request caused is done before its number is noted:
/// so numbers and counts are read before the rest, and the host never believes that less is left than there is.
void GroupClock::report(Lock& lock) {
  lock.unlock();
  wire::ClockReport report;
  report.set_request(request_);
  for (const auto& [peer, counts] : frames_()) {
    auto& one = *report.add_frames();
    one.set_peer(peer);
    one.set_sent(counts.sent);
    one.set_received(counts.received);
  }
  lock.lock();
  if (!idle()) return;
  report.set_step(done_step_);
  report.set_events(events_);
  report.set_staged(staged());
  if (next_timer() != TimePoint::max()) report.set_next_ns(next_timer().time_since_epoch().count());
  lock.unlock();
  send_lines();
  std::string bytes = report.SerializeAsString();
  if (bytes != last_report_) send(report);
  last_report_ = std::move(bytes);
  lock.lock();
}

void GroupClock::send_lines() {
  auto& all = *lines_->lines.mutable_delivered();
  if (all.empty()) return;
  wire::ClockReport part;
  part.set_partial(true);
  for (auto& line : all) {
    part.mutable_delivered()->Add(std::move(line));
    if (part.delivered_size() < kLinesPerMessage) continue;
    send(part);
    part.clear_delivered();
  }
  if (part.delivered_size() > 0) send(part);
  all.Clear();
}

/// Waits for a slow host: what it has not read yet is what time waits for. A host that is gone ends the stream.
void GroupClock::send(const wire::ClockReport& report) {
  const std::lock_guard lock(send_mutex_);
  if (stream_.send(report)) stream_.flush_all();
}

}  // namespace fiona::host
