#include "group.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <algorithm>
#include <iostream>
#include <thread>

#include "confinement.hpp"
#include "failure.hpp"
#include "fiona/error.hpp"
#include "link_keys.hpp"
#include "names.hpp"
#include "os/control_group.hpp"
#include "os/unix_socket.hpp"

namespace fiona::host {
namespace {

using Steady = std::chrono::steady_clock;
using std::chrono::milliseconds;

/// Of a life-cycle call, which has ten seconds of its own; of one that waits for a strand or a link, which have two.
constexpr milliseconds kLifeCycleRequest{12'000};
constexpr milliseconds kWaitingRequest{3'000};
/// Of all others, which a process that does not hang answers at once.
constexpr milliseconds kRequest{2'000};
constexpr std::chrono::seconds kReadyDeadline{5};

/// One that owes an answer for longer than any request may take has lost whoever gives them.
constexpr milliseconds kMostSilent{15'000};
/// To end an instance is two calls of its life cycle.
constexpr milliseconds kMostSilentAtEnd{25'000};

milliseconds patience_with(const wire::GroupRequest& request) {
  switch (request.what_case()) {
    case wire::GroupRequest::kCreate: return kLifeCycleRequest;
    case wire::GroupRequest::kDestroy: return kMostSilentAtEnd;
    case wire::GroupRequest::kSetParameters:
    case wire::GroupRequest::kWireRequire: return kWaitingRequest;
    default: return kRequest;
  }
}

/// Of what has not been begun by then nothing is done.
milliseconds limit(wire::GroupRequest& request) {
  const milliseconds patience = patience_with(request);
  request.set_expires_ns(std::chrono::nanoseconds((Steady::now() + patience).time_since_epoch()).count());
  return patience;
}

milliseconds most_silent(const wire::GroupRequest& request) {
  return request.has_destroy() ? kMostSilentAtEnd : kMostSilent;
}

/// Of the time since it was looked at last no more counts.
constexpr milliseconds kMostBetween{250};
/// Where a sandbox listens lies its one socket, while it is made under another name.
constexpr std::ptrdiff_t kMostSockets = 16;
constexpr std::chrono::seconds kCountEvery{1};
/// What a group may tell of itself, for each of its instances and once more.
constexpr std::size_t kMostStatus = 1U << 20U;

/// What a process may say that nobody has asked for, in bytes, while it does not answer; each message counts 256 more.
constexpr std::size_t kMostUnasked = 64U << 20U;
constexpr std::size_t kPerMessage = 256;

/// Of which there is no more than the host has asked for, or no more is kept.
bool is_bounded(const wire::GroupMessage& event) { return event.has_tapped() || event.has_call_ended(); }

/// Where a group finds its socket.
constexpr int kGroupSocket = 3;
constexpr int kClockSocket = 4;
constexpr int kLivenessPage = 5;
constexpr int kAdoptionSocket = 6;

std::vector<std::string> clock_arguments(const Clock& clock) {
  const auto* system = dynamic_cast<const SystemClock*>(&clock);
  if (!system) return {"--clock", "virtual", "--clock-start", std::to_string(clock.start().time_since_epoch().count())};
  const auto origin = system->origin();
  return {"--clock",        "system",
          "--clock-origin", std::to_string(origin.steady_ns),
          "--clock-start",  std::to_string(origin.start_ns)};
}

/// Descriptors: of a group, without its links; of a host, for each group; of a process, for its links to and from each
/// other one; what stays free for files of components and for consoles.
constexpr std::size_t kGroupBase = 34;
constexpr std::size_t kPerGroup = 4;
constexpr std::size_t kPerPeer = 3;
constexpr std::size_t kReserve = 32;

os::Descriptor either_readable(int first, int second) {
  os::Descriptor both(::epoll_create1(EPOLL_CLOEXEC));
  for (const int one : {first, second}) {
    epoll_event event{};
    event.events = EPOLLIN;
    ::epoll_ctl(both.get(), EPOLL_CTL_ADD, one, &event);
  }
  return both;
}

}  // namespace

Group::Group(std::string name, std::string link_key)
    : name_(std::move(name)), link_key_(link_key.empty() ? random_bytes(kKeyBytes) : std::move(link_key)) {}

wire::GroupMessage Group::request(wire::GroupRequest request) {
  const milliseconds patience = limit(request);
  wire::GroupMessage reply = perform(request, patience);
  if (reply.has_failure()) throw_failure(reply.failure());
  return reply;
}

std::function<void()> Group::begin(wire::GroupRequest request) {
  this->request(std::move(request));
  return [] {};
}

void Group::tell(wire::GroupRequest request) { perform(request, patience_with(request)); }

void Group::inform(wire::GroupRequest request) {
  if (silent_since()) return tell(std::move(request));
  wire::GroupMessage reply;
  try {
    reply = perform(request, patience_with(request));
  } catch (const Error&) {
    return;  // it is gone, or has it before it and does it when it comes to it
  }
  if (reply.has_failure()) throw_failure(reply.failure());
}

std::optional<wire::GroupStatusReply> Group::status(milliseconds) {
  wire::GroupRequest request;
  request.mutable_status();
  return perform(request, patience_with(request)).status();
}

void require_descriptors_for(const std::string& newcomer, std::size_t peers, std::uint64_t of_group) {
  const std::size_t links = kPerPeer * (peers + 1);
  if (kGroupBase + links > of_group) {
    throw Error(ErrorCode::NotAllowed,
                {.what = newcomer + " would bring the other groups to the end of their descriptors",
                 .expected = "room for " + std::to_string(kGroupBase + links) + " in each, most of them for its links",
                 .found = std::to_string(of_group),
                 .next = "use a group that is there, or start the host with --group-descriptors " +
                         std::to_string(4 * (kGroupBase + links))});
  }
  const std::size_t needed = kReserve + links + std::max(os::open_descriptors() + kPerGroup, kGroupBase);
  const std::size_t limit = os::descriptor_limit();
  if (needed <= limit) return;
  throw Error(ErrorCode::NotAllowed,
              {.what = newcomer + " would bring the host to the end of its descriptors",
               .expected = "room for " + std::to_string(needed) + ": those that are open, and links to each process",
               .found = "a limit of " + std::to_string(limit) + ", with " + std::to_string(peers) + " other processes",
               .next = "use a group that is there, or raise the limit before the host starts: ulimit -n " +
                       std::to_string(4 * needed)});
}

void require_descriptors_to_start() {
  constexpr std::size_t kNeeded = kReserve + kGroupBase + kPerPeer;
  const std::size_t limit = os::descriptor_limit();
  if (limit >= kNeeded) return;
  throw Error(ErrorCode::NotAllowed,
              {.what = "a host cannot live with so few descriptors",
               .expected = fmt::format("{} or more, and {} for each group", kNeeded, kPerGroup + kPerPeer),
               .found = fmt::format("a limit of {}", limit),
               .next = "ulimit -n 1024"});
}

MainGroup::MainGroup(Pool& pool, Clock& clock, PluginLibraries& libraries, std::string endpoint, std::string memory_key,
                     Runtime::OnEvent on_event)
    : Group("main"),
      clock_(dynamic_cast<VirtualClock*>(&clock)),
      runtime_(pool, clock, libraries, std::move(endpoint), {link_key(), std::move(memory_key)},
               Runtime::Watched::ByNobody, std::move(on_event)) {}

/// What was sent or staged on this thread, which is no strand's, is seen by a virtual clock once it looks.
wire::GroupMessage MainGroup::perform(const wire::GroupRequest& request, milliseconds) {
  auto reply = runtime_.handle(request);
  if (clock_) clock_->reconsider();
  return reply;
}

void MainGroup::peer_lost(const wire::PeerLost& gone) {
  wire::GroupRequest request;
  *request.mutable_peer_lost() = gone;
  tell(std::move(request));
}

pid_t MainGroup::process() const { return ::getpid(); }

/// With what a process of it needs, and without one.
ChildGroup::ChildGroup(std::string name, const Start& start, Runtime::OnEvent on_event, Unstarted)
    : Group(std::move(name)),
      endpoint_(start.endpoint),
      folder_(start.folder),
      confinement_(start.confinement),
      clock_(start.clock),
      master_(start.master),
      supervisor_(start.master ? nullptr : start.supervisor),  // a run on virtual time ends with its host
      copied_(start.copied),
      meanwhile_(start.meanwhile),
      on_event_(std::move(on_event)),
      cpu_(start.cores),
      liveness_(std::make_unique<os::SharedMemory>(sizeof(Liveness::Page))) {}

/// Where it throws, the destructor takes back what has been made so far.
ChildGroup::ChildGroup(std::string name, const Start& start, Runtime::OnEvent on_event)
    : ChildGroup(std::move(name), start, std::move(on_event), Unstarted()) {
  if (!folder_.empty()) std::filesystem::create_directories(folder_);
  // Virtual time has a watchdog of its own.
  const auto& page = *static_cast<const Liveness::Page*>(liveness_->data());
  if (start.parts && !start.master) hangs_ = std::make_unique<HangWatch>(page, start.parts);
  if (!confinement_.buses().empty()) bus_ = std::make_unique<BusProxy>(this->name(), confinement_);
  auto [ours, theirs] = os::socket_pair();
  std::vector<std::string> arguments{"--name",  this->name(), "--endpoint",
                                     endpoint_, "--threads",  std::to_string(start.threads)};
  for (auto& argument : clock_arguments(clock_)) arguments.push_back(std::move(argument));
  std::vector<std::pair<int, int>> inherited{{output_.write_end(), STDOUT_FILENO},
                                             {output_.write_end(), STDERR_FILENO},
                                             {theirs.get(), kGroupSocket},
                                             {liveness_->descriptor(), kLivenessPage}};
  os::Descriptor clock_socket;
  if (master_) clock_socket = master_->add(this->name(), endpoint_);
  if (master_) inherited.emplace_back(clock_socket.get(), kClockSocket);
  std::pair<os::PacketSocket, os::PacketSocket> adoption;
  if (supervisor_) adoption = os::PacketSocket::pair();
  if (supervisor_) inherited.emplace_back(adoption.second.descriptor(), kAdoptionSocket);
  if (copied_) child_ = copied_->copy(arguments, inherited);
  if (!child_) {
    child_ = std::make_unique<os::ChildProcess>(os::program_directory() / kGroupProgram, arguments, inherited,
                                                confinement_.sandboxed());
  }
  clock_socket.reset();
  adoption.second.close();
  theirs.reset();
  output_.close_write_end();
  stream_ = std::make_unique<os::MessageStream>(std::move(ours));
  wake_ = either_readable(stream_->descriptor(), child_->descriptor());
  wire::GroupRequest welcome;
  welcome.mutable_welcome()->set_key(link_key());
  *welcome.mutable_welcome()->mutable_confinement() = confinement_;
  welcome.mutable_welcome()->set_host(start.host);
  welcome.mutable_welcome()->set_adoptable(supervisor_ != nullptr);
  if (!confinement_.sandboxed()) welcome.mutable_welcome()->set_memory_key(start.memory_key);
  stream_->send(welcome);
  // An exit with code 0 before it says ready is a failure too.
  const auto ready = wait_for(0, Steady::now() + kReadyDeadline);
  if (!ready || !ready->has_ready()) throw not_started();
  ready_ = ready->ready();
  if (ready_.protocol() != kGroupProtocol) throw not_of_this_build();
  require_sandbox(this->name(), ready_);
  if (bus_) bus_->require_ready(Steady::now() + kReadyDeadline);
  if (supervisor_) hand_to_supervisor(std::move(adoption.first), start.memory_key);
}

ChildGroup::ChildGroup(KeptGroup kept, const Start& start, Runtime::OnEvent on_event)
    : Group(kept.told.name(), kept.told.key()),
      endpoint_(kept.told.endpoint()),
      folder_(kept.told.folder()),
      confinement_(kept.told.confinement()),
      ready_(kept.told.ready()),
      clock_(start.clock),
      master_(nullptr),
      supervisor_(start.supervisor),
      meanwhile_(start.meanwhile),
      on_event_(std::move(on_event)),
      cpu_(start.cores),
      output_(std::move(kept.output)),
      liveness_(std::make_unique<os::SharedMemory>(std::move(kept.liveness), sizeof(Liveness::Page))) {
  const auto& page = *static_cast<const Liveness::Page*>(liveness_->data());
  if (start.parts) hangs_ = std::make_unique<HangWatch>(page, start.parts);
  child_ = std::make_unique<os::ChildProcess>(
      kept.process, std::move(kept.handle), [supervisor = supervisor_](pid_t one) { return supervisor->end_of(one); });
  if (!confinement_.buses().empty()) bus_ = std::make_unique<BusProxy>(this->name(), confinement_);
  if (ready_.protocol() != kGroupProtocol) {
    end_now(fmt::format("was ended: it speaks protocol {}, and the host that has taken over speaks {}",
                        ready_.protocol(), kGroupProtocol));
    return;
  }
  auto [ours, theirs] = os::socket_pair();
  const os::PacketSocket adoption(std::move(kept.adoption));
  const bool handed = adoption.send("host", {theirs.get()}) == os::PacketSocket::Sent::Yes;
  theirs.reset();
  stream_ = std::make_unique<os::MessageStream>(std::move(ours));
  wake_ = either_readable(stream_->descriptor(), child_->descriptor());
  wire::GroupRequest adopt;
  adopt.mutable_adopt();
  if (handed && send(adopt)) adoption_ = adopt.id();
}

void ChildGroup::finish_adoption(Time deadline) {
  if (!alive()) return;
  const auto reply = adoption_ != 0 ? wait_for(adoption_, deadline) : std::nullopt;
  if (reply && reply->has_adopted()) adopted_ = reply->adopted();
  if (!adopted_) return end_now("was ended: it did not answer the new host");
  subjects_.hold(*adopted_);
  for (const auto& event : std::exchange(early_, {})) pass_on(event);
}

/// One that is not kept ends with this host; that is no reason not to have it.
void ChildGroup::hand_to_supervisor(os::PacketSocket adoption, const std::string& memory_key) {
  KeptGroup kept;
  kept.process = process();
  kept.told.set_name(name());
  kept.told.set_endpoint(endpoint_);
  kept.told.set_folder(folder_.string());
  kept.told.set_key(link_key());
  kept.told.set_memory_key(memory_key);
  *kept.told.mutable_confinement() = confinement_;
  *kept.told.mutable_ready() = ready_;
  if (const auto* system = dynamic_cast<const SystemClock*>(&clock_)) {
    kept.told.set_clock_steady_ns(system->origin().steady_ns);
    kept.told.set_clock_start_ns(system->origin().start_ns);
  }
  const auto copy = [](int one) { return os::Descriptor(::fcntl(one, F_DUPFD_CLOEXEC, 0)); };
  kept.adoption = copy(adoption.descriptor());
  kept.liveness = copy(liveness_->descriptor());
  kept.output = copy(output_.read_end());
  kept.handle = copy(child_->descriptor());
  if (supervisor_->keep(kept)) return;
  adoption_end_ = std::move(adoption);
  std::cerr << "group '" << name() << "' ends with this host: its supervisor is gone\n";
}

void ChildGroup::end_now(const std::string& why) {
  if (!alive()) return;
  const bool lives = child_->end().empty();
  child_->kill();
  note_end(lives ? why : "");
}

Error ChildGroup::not_started() const {
  return Error(ErrorCode::Failed, {.what = "group '" + this->name() + "' did not start",
                                   .found = end_.empty() ? "no answer within 5 s" : end_,
                                   .next = "fiona doctor"});
}

/// Its program has been replaced since the host's own was started.
Error ChildGroup::not_of_this_build() const {
  return Error(ErrorCode::Failed, {.what = "group '" + this->name() + "' did not start: " +
                                           (os::program_directory() / kGroupProgram).string() + " is of another build",
                                   .expected = fmt::format("protocol {}", kGroupProtocol),
                                   .found = fmt::format("protocol {}", ready_.protocol()),
                                   .next = "upgrade host"});
}

ChildGroup::~ChildGroup() {
  if (supervisor_ && child_ && alive()) supervisor_->drop(child_->id());
  if (master_) master_->remove(endpoint_);
  std::error_code ignored;
  if (!folder_.empty()) std::filesystem::remove_all(folder_, ignored);
  if (!child_) return;
  const pid_t ended = process();
  child_.reset();
  if (cpu_.most() > 0) os::remove_cpu_limit(ended);
}

/// What it says of others is dropped.
void ChildGroup::pass_on(const wire::GroupMessage& event) {
  if (subjects_.take(event)) {
    on_event_(event);
  } else {
    disbelief_.tell(fmt::format("group '{}'", name()), event);
  }
  if (master_) master_->event_seen(endpoint_);
}

/// With the next number and, for a virtual clock, the time. `wait_for` passes over an answer that nobody waits for.
bool ChildGroup::send(wire::GroupRequest& request) {
  request.set_id(next_id_++);
  request.set_now_ns(clock_.now().time_since_epoch().count());
  if (master_) master_->request_sent(endpoint_, request.id());
  subjects_.ask(request);
  return alive() && stream_->send(request);
}

void ChildGroup::peer_lost(const wire::PeerLost& gone) {
  wire::GroupRequest request;
  *request.mutable_peer_lost() = gone;
  tell(std::move(request));
}

bool ChildGroup::wait_readable(Time deadline) const {
  while (true) {
    const auto left = std::chrono::ceil<milliseconds>(deadline - Steady::now()).count();
    const bool has_more = stream_->unsent() > 0 && !stream_->closed();
    pollfd waits[] = {{wake_.get(), POLLIN, 0}, {has_more ? stream_->descriptor() : -1, POLLOUT, 0}};
    ::poll(waits, std::size(waits), static_cast<int>(std::clamp<std::int64_t>(left, 0, 60'000)));
    if (waits[1].revents != 0) stream_->flush();
    if (waits[0].revents != 0) return true;
    if (left <= 0) return false;
  }
}

/// Reads what it has said. False once it has ended: what it said before is still to be had from the stream.
bool ChildGroup::receive() {
  pollfd ended{child_->descriptor(), POLLIN, 0};
  ::poll(&ended, 1, 0);  // before reading: what it said before its end is in the socket then
  return stream_->receive() && ended.revents == 0;
}

/// The socket closes a moment before the process can be reaped.
bool ChildGroup::await_end() {
  for (int tries = 0; tries < 50 && end_.empty(); ++tries) {
    end_ = child_->end();
    if (end_.empty()) std::this_thread::sleep_for(milliseconds(2));
  }
  return !end_.empty();
}

void ChildGroup::note_end(const std::string& why) {
  if (!end_.empty()) return;
  if (!await_end()) {  // it would go on without anybody who looks after it
    child_->kill();
    await_end();
    const std::string fault = stream_ ? stream_->fault() : "";
    end_ = fault.empty() ? "closed its connection to the host" : "was ended: it said " + fault;
  }
  if (!why.empty()) end_ = why;
  if (supervisor_) supervisor_->drop(child_->id());  // whose number may be another's soon
  std::cerr << output_.take(Steady::now());
  if (const std::string said = output_.last_lines(); !said.empty()) end_ += "; it wrote: " + said;
}

std::optional<wire::GroupMessage> ChildGroup::wait_for(std::uint64_t id, Time deadline) {
  is_waited_for_ = true;
  auto found = read_until(id, deadline);
  is_waited_for_ = false;
  return found;
}

/// The message with this id, passing on events meanwhile; none when the deadline passes, however much is said
/// meanwhile, or the process ends.
std::optional<wire::GroupMessage> ChildGroup::read_until(std::uint64_t id, Time deadline) {
  wire::GroupMessage message;
  std::optional<wire::GroupMessage> found;
  std::size_t said = 0;
  bool ended = false, late = false;
  while (true) {
    if (supervisor_) supervisor_->beat();
    if (meanwhile_) meanwhile_();
    // To the end of what has been read, though the answer be found: nobody polls for bytes that are here already.
    while (stream_->next(message)) {
      if (message.id() == id && (id != 0 || message.has_ready())) {
        found = message;
      }
      if (!is_bounded(message)) said += message.ByteSizeLong() + kPerMessage;
      take(message);
    }
    if (found) return found;
    if (said > kMostUnasked)
      end_now(fmt::format("was ended: it said more than {} MiB and did not answer", kMostUnasked >> 20U));
    if (ended) note_end();
    if (ended || late || !alive()) return std::nullopt;
    const Time now = Steady::now();
    late = now >= deadline;  // what has come by then is still looked at, once
    const bool readable = wait_readable(hangs_ ? std::min(deadline, now + kWatchWaiting) : deadline);
    watch(now);
    ended = !alive() || (readable && !receive());
  }
}

/// Of its own memory the kernel refuses it more; what it shares, and threads, it counts for nobody.
void ChildGroup::end_if_greedy() {
  const auto now = os::usage_of(process());
  if (!now) return;
  const bool memory = os::kLimitsMemory && now->memory > confinement_.memory() + confinement_.memory() / 8;
  const bool threads = now->threads > confinement_.threads();
  const bool descriptors = now->descriptors > confinement_.descriptors();
  if (cpu_.exceeds(Steady::now(), now->cpu_time)) hold_cpu();
  if (!memory && !threads && !descriptors) return;
  child_->kill();
  if (memory) {
    note_end(fmt::format("was ended: it took {} MiB of memory, of {} that it may have", now->memory >> 20U,
                         confinement_.memory() >> 20U));
  } else {
    note_end(fmt::format("was ended: it had {} {}, of {} that it may have", threads ? now->threads : now->descriptors,
                         threads ? "threads" : "descriptors",
                         threads ? confinement_.threads() : confinement_.descriptors()));
  }
}

/// Where it listens it may make sockets, in a folder of its user's, who has no bound for them there.
void ChildGroup::end_if_crowded(Time now) {
  if (!confinement_.sandboxed() || folder_.empty() || now - counted_ < kCountEvery) return;
  counted_ = now;
  std::error_code ignored;
  std::ptrdiff_t found = 0;
  for (std::filesystem::directory_iterator one(folder_, ignored);
       found <= kMostSockets && !ignored && one != std::filesystem::directory_iterator(); one.increment(ignored))
    ++found;
  if (found > kMostSockets) end_now(fmt::format("was ended: it made more than {} sockets", kMostSockets));
}

/// Its strands may go on, but nobody can change it, look at it or unload it any more.
void ChildGroup::end_if_silent(milliseconds passed) {
  if (!unanswered_ || (unanswered_->looked_at += passed) < unanswered_->most) return;
  end_now(fmt::format("was ended: it did not answer for {} s",
                      std::chrono::duration_cast<std::chrono::seconds>(unanswered_->most).count()));
}

/// Without its way to D-Bus it is no use: it is started again with a new one, as often as any group.
void ChildGroup::watch_bus(Time now) {
  bus_->watch(now);
  if (bus_->end().empty()) return;
  child_->kill();
  note_end("was ended: " + bus_->end());
}

/// By a control group, where this user may have one; else it is put behind all others.
void ChildGroup::hold_cpu() {
  try {
    os::limit_cpu(os::cpu_groups(), process(), cpu_.most());
    cpu_held_by_ = "it gets no more";
  } catch (const std::exception& obstacle) {
    os::put_last(process());
    cpu_held_by_ = fmt::format("it gets what others leave, as it can have no control group: {}", obstacle.what());
  }
  std::cerr << fmt::format("group '{}' has taken {:.2f} cores, of {:.2f} that it may take: from now on {}\n", name(),
                           cpu_.cores(), cpu_.most(), cpu_held_by_);
}

/// A process that says much is waited for again and again: it is looked at as often as any other.
void ChildGroup::watch(Time now) {
  if (alive()) stream_->flush();  // of what nobody waits for
  if (now - watched_ < kWatchWaiting) return;
  const auto passed =
      std::min(std::chrono::duration_cast<milliseconds>(now - std::exchange(watched_, now)), kMostBetween);
  if (alive()) std::cerr << output_.take(now);
  if (alive()) end_if_greedy();
  if (alive()) end_if_crowded(now);
  if (alive() && bus_) watch_bus(now);
  if (hangs_ && alive()) end_if_silent(passed);
  if (!hangs_ || !alive()) return;
  const auto hangs = hangs_->look(now, child_->id(), child_->is_stopped());
  if (hangs.empty()) return;
  child_->kill();
  note_end("was ended: " + hangs.front().text());
}

/// An event, or a late answer: whoever asked waits no more, but the process answers again.
void ChildGroup::take(const wire::GroupMessage& message) {
  if (message.id() != 0) subjects_.answered(message);
  const bool is_event = message.id() == 0 && !message.has_ready();
  const bool is_early = adoption_ != 0 && !adopted_;
  if (is_event && !is_early) pass_on(message);
  if (is_event && is_early && !is_bounded(message)) early_.push_back(message);
  if (!unanswered_ || message.id() != unanswered_->id) return;
  unanswered_.reset();
  is_read_later_ = false;
}

Error ChildGroup::unreachable() const {
  ErrorText text{.what = "group '" + name() + "' does not answer", .found = end_, .next = "ls"};
  if (alive() && unanswered_) {
    text.found =
        fmt::format("silent for {:.1f} s", std::chrono::duration<double>(Steady::now() - unanswered_->since).count());
    text.next = fmt::format("wait for it, or end its process: kill -KILL {}", child_->id());
  }
  return Error(ErrorCode::Unreachable, std::move(text));
}

/// One that is silent is not asked again: that would only queue up before it. But a machine with too much to do is
/// silent too, so it has the time of a request before its silence counts.
wire::GroupMessage ChildGroup::perform(const wire::GroupRequest& request, milliseconds deadline) {
  if (unanswered_) wait_for(unanswered_->id, unanswered_->since + kRequest);
  wire::GroupRequest numbered = request;
  if (ask_if_it_answers(numbered)) {
    if (auto reply = wait_for(numbered.id(), unanswered_->since + deadline)) return std::move(*reply);
  }
  if (stream_->closed()) note_end();
  throw unreachable();
}

/// False: it has something to answer before, or is gone.
bool ChildGroup::ask_if_it_answers(wire::GroupRequest& request) {
  if (unanswered_ || !send(request)) return false;
  unanswered_ = {request.id(), Steady::now(), most_silent(request)};
  return true;
}

void ChildGroup::ask(wire::GroupRequest request) {
  if (!ask_if_it_answers(request)) send(request);
}

/// In virtual time one thing is done after the other. Who asks it for something else first has read the answer.
std::function<void()> ChildGroup::begin(wire::GroupRequest request) {
  const milliseconds patience = limit(request);
  if (master_ || !ask_if_it_answers(request)) return Group::begin(std::move(request));
  is_read_later_ = true;
  return [this, id = request.id(), deadline = unanswered_->since + patience] {
    is_read_later_ = false;
    if (!unanswered_ || unanswered_->id != id) return;
    const auto reply = wait_for(id, deadline);
    if (reply && reply->has_failure()) throw_failure(reply->failure());
    if (reply) return;
    if (stream_->closed()) note_end();
    throw unreachable();
  };
}

void ChildGroup::require_answer() {
  wire::GroupRequest ping;
  ping.mutable_ping();
  perform(ping, kRequest);
}

void ChildGroup::ask_status() {
  if (unanswered_) wait_for(unanswered_->id, unanswered_->since);  // which may have come by now
  wire::GroupRequest request;
  request.mutable_status();
  ask_if_it_answers(request);
  is_read_later_ = unanswered_.has_value();
}

std::optional<wire::GroupStatusReply> ChildGroup::status(milliseconds patience) {
  const auto reply = unanswered_ ? wait_for(unanswered_->id, unanswered_->since + patience) : std::nullopt;
  is_read_later_ = false;
  if (stream_->closed()) note_end();  // as asking may have shown already
  if (!reply || !reply->has_status()) return std::nullopt;
  const std::size_t most = kMostStatus * (1 + subjects_.instances());
  if (const std::size_t told = reply->ByteSizeLong(); told > most) {
    end_now(fmt::format("was ended: what it tells of itself, with all parameters, has {:.1f} MiB, of at most {}",
                        static_cast<double>(told) / (1U << 20U), most >> 20U));
    return std::nullopt;
  }
  return reply->status();
}

std::optional<ChildGroup::Time> ChildGroup::silent_since() const {
  return unanswered_ ? std::optional(unanswered_->since) : std::nullopt;
}

bool ChildGroup::serve() {
  if (!alive()) return false;
  const bool open = receive();
  wire::GroupMessage message;
  while (stream_->next(message)) take(message);
  if (!open || stream_->closed()) note_end();
  return alive();
}

}  // namespace fiona::host
