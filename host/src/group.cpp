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
constexpr int kClockSocket = 4;

std::vector<std::string> clock_arguments(const Clock& clock) {
  const auto* system = dynamic_cast<const SystemClock*>(&clock);
  if (!system) return {"--clock", "virtual"};
  const auto origin = system->origin();
  return {"--clock", "system", "--clock-origin", std::to_string(origin.steady_ns), "--clock-start",
          std::to_string(origin.start_ns)};
}

}  // namespace

wire::GroupMessage Group::request(wire::GroupRequest request) {
  wire::GroupMessage reply = perform(request);
  if (reply.has_failure()) throw_failure(reply.failure());
  return reply;
}

MainGroup::MainGroup(Pool& pool, Clock& clock, PluginLibraries& libraries, std::string endpoint,
                     Runtime::OnEvent on_event)
    : Group("main"),
      clock_(dynamic_cast<VirtualClock*>(&clock)),
      runtime_(pool, clock, libraries, std::move(endpoint), std::move(on_event)) {}

wire::GroupMessage MainGroup::perform(const wire::GroupRequest& request) {
  auto reply = runtime_.handle(request);
  reconsider();
  return reply;
}

void MainGroup::peer_lost(const std::string& lost, const std::string& reason) {
  runtime_.peer_lost(lost, reason);
  reconsider();
}

/// What was sent or staged on this thread, which is no strand's, is seen by a virtual clock once it looks.
void MainGroup::reconsider() {
  if (clock_) clock_->reconsider();
}

pid_t MainGroup::process() const { return ::getpid(); }

ChildGroup::ChildGroup(std::string name, const Start& start, Runtime::OnEvent on_event)
    : Group(std::move(name)), endpoint_(start.endpoint), clock_(start.clock), master_(start.master), on_event_(std::move(on_event)) {
  auto [ours, theirs] = os::socket_pair();
  std::vector<std::string> arguments{"--name", this->name(), "--endpoint", endpoint_, "--threads", std::to_string(start.threads)};
  for (auto& argument : clock_arguments(clock_)) arguments.push_back(std::move(argument));
  std::vector<std::pair<int, int>> inherited{{theirs.get(), kGroupSocket}};
  os::Descriptor clock_socket;
  if (master_) clock_socket = master_->add(this->name(), endpoint_);
  if (master_) inherited.emplace_back(clock_socket.get(), kClockSocket);
  child_ = std::make_unique<os::ChildProcess>(os::program_directory() / "fiona-group", arguments, inherited);
  clock_socket.reset();
  theirs.reset();
  stream_ = std::make_unique<os::MessageStream>(std::move(ours));
  // An exit with code 0 before it says ready is a failure too.
  const auto ready = wait_for(0, kReadyDeadline);
  if (ready && ready->has_ready()) return;
  if (master_) master_->remove(endpoint_);
  throw Error(ErrorCode::Failed, {.what = "group '" + this->name() + "' did not start",
                                  .found = end_.empty() ? "no answer within 5 s" : end_});
}

ChildGroup::~ChildGroup() {
  if (master_) master_->remove(endpoint_);
}

void ChildGroup::pass_on(const wire::GroupMessage& event) {
  on_event_(event);
  if (master_) master_->event_seen(endpoint_);
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
        pass_on(message);
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
  numbered.set_now_ns(clock_.now().time_since_epoch().count());
  if (master_) master_->request_sent(endpoint_, numbered.id());
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
    if (message.id() == 0) pass_on(message);
  }
  if (!open || stream_->closed()) note_end();
  return alive();
}

}  // namespace fiona::host
