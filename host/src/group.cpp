#include "group.hpp"

#include <unistd.h>

#include <thread>

#include "fiona/error.hpp"

namespace fiona::host {
namespace {

/// A request may hold a life-cycle call, which has ten seconds of its own.
constexpr std::chrono::seconds kRequestDeadline{12};
constexpr std::chrono::seconds kReadyDeadline{5};
/// Where a group finds its socket.
constexpr int kGroupSocket = 3;

}  // namespace

wire::GroupMessage Group::request(wire::GroupRequest request) {
  wire::GroupMessage reply = perform(request);
  if (reply.has_failure()) throw_failure(reply.failure());
  return reply;
}

MainGroup::MainGroup(Pool& pool, Clock& clock, PluginLibraries& libraries, std::string endpoint,
                     Runtime::OnEvent on_event)
    : Group("main"), runtime_(pool, clock, libraries, std::move(endpoint), std::move(on_event)) {}

pid_t MainGroup::process() const { return ::getpid(); }

ChildGroup::ChildGroup(std::string name, const std::string& endpoint, const SystemClock& clock, Runtime::OnEvent on_event)
    : Group(std::move(name)), endpoint_(endpoint), on_event_(std::move(on_event)) {
  auto [ours, theirs] = os::socket_pair();
  const auto origin = clock.origin();
  child_ = std::make_unique<os::ChildProcess>(
      os::program_directory() / "fiona-group",
      std::vector<std::string>{"--name", this->name(), "--endpoint", endpoint, "--clock-origin",
                               std::to_string(origin.steady_ns), "--clock-start", std::to_string(origin.start_ns)},
      std::vector<std::pair<int, int>>{{theirs.get(), kGroupSocket}});
  theirs.reset();
  stream_ = std::make_unique<os::MessageStream>(std::move(ours));
  // An exit with code 0 before it says ready is a failure too.
  const auto ready = wait_for(0, kReadyDeadline);
  if (ready && ready->has_ready()) return;
  throw Error(ErrorCode::Failed, {.what = "group '" + this->name() + "' did not start",
                                  .found = end_.empty() ? "no answer within 5 s" : end_});
}

void ChildGroup::note_end() {
  if (!end_.empty()) return;
  // The socket closes a moment before the process can be reaped.
  for (int tries = 0; tries < 50 && end_.empty(); ++tries) {
    end_ = child_->end();
    if (end_.empty()) std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  if (end_.empty()) end_ = "closed its connection to the host";
}

/// The message with this id, passing on events meanwhile; none when the deadline passes or the process ends.
std::optional<wire::GroupMessage> ChildGroup::wait_for(std::uint64_t id, std::chrono::seconds deadline) {
  const auto end = std::chrono::steady_clock::now() + deadline;
  wire::GroupMessage message;
  std::optional<wire::GroupMessage> found;
  while (true) {
    // To the end of what has been read, though the answer be found: nobody polls for bytes that are here already.
    while (stream_->next(message)) {
      if (message.id() == id && (id != 0 || message.has_ready())) {
        found = message;
      } else if (message.id() == 0) {
        on_event_(message);
      }
    }
    if (found) return found;
    if (!stream_->wait_readable(end)) return std::nullopt;
    if (!stream_->receive()) {
      note_end();
      return std::nullopt;
    }
  }
}

wire::GroupMessage ChildGroup::perform(const wire::GroupRequest& request) {
  wire::GroupRequest numbered = request;
  numbered.set_id(next_id_++);
  if (alive() && stream_->send(numbered)) {
    if (auto reply = wait_for(numbered.id(), kRequestDeadline)) return std::move(*reply);
  }
  if (stream_->closed()) note_end();
  throw Error(ErrorCode::Unreachable, {.what = "group '" + name() + "' does not answer",
                                       .found = alive() ? "alive, but silent" : end_,
                                       .next = "ls hosts"});
}

bool ChildGroup::serve() {
  if (!alive()) return false;
  const bool open = stream_->receive();
  wire::GroupMessage message;
  while (stream_->next(message)) {
    if (message.id() == 0) on_event_(message);
  }
  if (!open || stream_->closed()) note_end();
  return alive();
}

}  // namespace fiona::host
