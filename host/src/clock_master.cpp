#include "clock_master.hpp"

#include <fmt/format.h>

#include <thread>

#include "os/message_stream.hpp"
#include "os/unix_socket.hpp"

namespace fiona::host {
namespace {

/// A stream is looked at again after so long though nothing came.
constexpr std::chrono::seconds kLook{60};

}  // namespace

struct ClockMaster::Member {
  Member(std::string n, os::Descriptor socket) : name(std::move(n)), stream(std::move(socket)) {}
  ~Member() {
    stream.shut_down();
    if (reader.joinable()) reader.join();
  }

  /// It has done all it was told, and the host knows all that happened.
  bool quiet() const {
    return reported && report.step() == step && report.request() >= request && events >= report.events();
  }

  const std::string name;
  os::MessageStream stream;
  bool reported = false;
  wire::ClockReport report;
  Counts counts;
  std::uint64_t step = 0;
  std::uint64_t request = 0;
  std::uint64_t events = 0;
  TimePoint at{};  ///< of the step
  bool answered = false;
  std::vector<std::string> running;
  std::thread reader;
};

ClockMaster::ClockMaster(VirtualClock& clock, std::string endpoint, Frames frames)
    : clock_(clock), endpoint_(std::move(endpoint)), frames_(std::move(frames)) {}

ClockMaster::~ClockMaster() = default;

os::Descriptor ClockMaster::add(const std::string& name, const std::string& endpoint) {
  auto [ours, theirs] = os::socket_pair();
  auto member = std::make_unique<Member>(name, std::move(ours));
  Member& reading = *member;
  {
    const std::lock_guard lock(mutex_);
    members_[endpoint] = std::move(member);
  }
  reading.reader = std::thread([this, &reading] { serve(reading); });
  return std::move(theirs);
}

void ClockMaster::remove(const std::string& endpoint) {
  std::unique_ptr<Member> gone;  // ends its thread outside the lock
  {
    const std::lock_guard lock(mutex_);
    const auto found = members_.find(endpoint);
    if (found == members_.end()) return;
    gone = std::move(found->second);
    members_.erase(found);
  }
  gone.reset();
  clock_.reconsider();
}

void ClockMaster::request_sent(const std::string& endpoint, std::uint64_t request) {
  const std::lock_guard lock(mutex_);
  const auto found = members_.find(endpoint);
  if (found != members_.end()) found->second->request = request;
}

void ClockMaster::event_seen(const std::string& endpoint) {
  {
    const std::lock_guard lock(mutex_);
    const auto found = members_.find(endpoint);
    if (found == members_.end()) return;
    ++found->second->events;
  }
  clock_.reconsider();
}

void ClockMaster::set_recorder(std::shared_ptr<DeliveryRecorder> recorder) {
  const std::lock_guard lock(mutex_);
  recorder_.swap(recorder);
}

void ClockMaster::serve(Member& member) {
  wire::ClockReport report;
  while (true) {
    bool any = false;
    while (member.stream.next(report)) {
      on_report(member, report);
      any = true;
    }
    if (any) clock_.reconsider();
    member.stream.wait_readable(std::chrono::steady_clock::now() + kLook);
    if (!member.stream.receive()) return;  // supervision notes the end of the process
  }
}

namespace {

/// Whether something has happened between two reports of a group, beside questions that it was asked: who waits for
/// time asks now and then, and that is no progress.
bool has_moved(const wire::ClockReport& before, const wire::ClockReport& now) {
  const auto same = [](const wire::FrameCount& a, const wire::FrameCount& b) {
    return a.peer() == b.peer() && a.sent() == b.sent() && a.received() == b.received();
  };
  return before.step() != now.step() || before.events() != now.events() || before.staged() != now.staged() ||
         before.next_ns() != now.next_ns() || now.delivered_size() > 0 ||
         !std::equal(before.frames().begin(), before.frames().end(), now.frames().begin(), now.frames().end(), same);
}

}  // namespace

void ClockMaster::on_report(Member& member, const wire::ClockReport& report) {
  const std::lock_guard lock(mutex_);
  if (report.busy()) {
    member.answered = true;
    member.running.assign(report.running().begin(), report.running().end());
    return;
  }
  if (!member.reported || report.partial() || has_moved(member.report, report)) ++reports_;
  for (const auto& line : report.delivered()) {
    if (recorder_) recorder_->delivered(member.at, line.wire(), line.sequence(), line.what());
  }
  if (report.partial()) return;
  member.reported = true;
  member.report = report;
  for (const auto& frames : report.frames()) member.counts[frames.peer()] = {frames.sent(), frames.received()};
}

const ClockMaster::Counts* ClockMaster::counts_of(const std::string& endpoint, const Counts& own) const {
  if (endpoint == endpoint_) return &own;
  const auto found = members_.find(endpoint);
  return found == members_.end() ? nullptr : &found->second->counts;
}

/// The peers with which the counts of this process are not even. What goes to or from one that is gone does not count.
std::vector<std::string> ClockMaster::on_their_way(const std::string& endpoint, const std::string& name,
                                                   const Counts& counts, const Counts& own) const {
  std::vector<std::string> uneven;
  for (const auto& [peer, ours] : counts) {
    const Counts* of_peer = counts_of(peer, own);
    if (!of_peer) continue;
    const auto found = of_peer->find(endpoint);
    const FrameCounts theirs = found == of_peer->end() ? FrameCounts{} : found->second;
    if (ours.sent == theirs.received && ours.received == theirs.sent) continue;
    uneven.push_back(fmt::format("messages are on their way between {} and {}", name, peer));
  }
  return uneven;
}

OtherProcesses::Situation ClockMaster::situation() {
  const Counts own = frames_();  // before the host's own strands are looked at
  const std::lock_guard lock(mutex_);
  Situation all;
  for (const auto& [endpoint, member] : members_) {
    if (!member->quiet()) return {false};
    all.staged = all.staged || member->report.staged() > 0;
    if (member->report.has_next_ns()) all.next = std::min(all.next, TimePoint(Duration(member->report.next_ns())));
  }
  if (members_.empty()) return all;
  all.quiet = on_their_way(endpoint_, "main", own, own).empty();
  for (auto it = members_.begin(); all.quiet && it != members_.end(); ++it) {
    all.quiet = on_their_way(it->first, it->second->name, it->second->counts, own).empty();
  }
  return all;
}

void ClockMaster::send_step(Member& member, TimePoint at, std::uint64_t deliver) {
  wire::ClockStep step;
  step.set_step(++member.step);
  step.set_now_ns(at.time_since_epoch().count());
  step.set_deliver(deliver);
  step.set_record(recorder_ != nullptr);
  member.at = at;
  member.stream.send(step);  // one that is gone is removed by supervision
}

void ClockMaster::deliver(TimePoint at) {
  const std::lock_guard lock(mutex_);
  for (const auto& [endpoint, member] : members_) {
    if (member->report.staged() > 0) send_step(*member, at, member->report.staged());
  }
}

void ClockMaster::fire(TimePoint at) {
  const std::lock_guard lock(mutex_);
  for (const auto& [endpoint, member] : members_) {
    const auto& report = member->report;
    if (report.has_next_ns() && TimePoint(Duration(report.next_ns())) <= at) send_step(*member, at, 0);
  }
}

void ClockMaster::ask_what_runs() {
  const std::lock_guard lock(mutex_);
  for (const auto& [endpoint, member] : members_) {
    member->answered = false;
    if (!member->quiet()) member->stream.send(wire::ClockStep());
  }
}

std::vector<std::string> ClockMaster::blockers() {
  const Counts own = frames_();
  const std::lock_guard lock(mutex_);
  std::vector<std::string> all;
  for (const auto& [endpoint, member] : members_) {
    if (member->quiet()) continue;
    if (!member->answered) all.push_back(fmt::format("group '{}' is silent", member->name));
    for (const auto& name : member->running) all.push_back(fmt::format("'{}' in group '{}' runs", name, member->name));
    if (member->answered && member->running.empty())
      all.push_back(fmt::format("group '{}' has not reported", member->name));
  }
  if (!all.empty()) return all;
  all = on_their_way(endpoint_, "main", own, own);
  for (const auto& [endpoint, member] : members_) {
    for (auto& text : on_their_way(endpoint, member->name, member->counts, own)) all.push_back(std::move(text));
  }
  return all;
}

bool ClockMaster::empty() const {
  const std::lock_guard lock(mutex_);
  return members_.empty();
}

std::uint64_t ClockMaster::progress() const {
  const std::lock_guard lock(mutex_);
  return reports_;
}

}  // namespace fiona::host
