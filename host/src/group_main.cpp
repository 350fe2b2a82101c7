// fiona-group: the process of a group. It is started by a host, inherits a socket to it as descriptor 3, does what
// comes over that socket, and ends when the socket closes.
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <google/protobuf/stubs/logging.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <iostream>
#include <string>
#include <thread>
#include <vector>

#include "failure.hpp"
#include "fiona/error.hpp"
#include "group.hpp"
#include "group_clock.hpp"
#include "mailbox.hpp"
#include "names.hpp"
#include "open_plugin.hpp"
#include "os/control_group.hpp"
#include "os/limits.hpp"
#include "os/message_stream.hpp"
#include "os/packet_socket.hpp"
#include "os/process.hpp"
#include "os/process_template.hpp"
#include "os/read_pages.hpp"
#include "os/sandbox.hpp"
#include "os/shared_memory.hpp"
#include "os/spare_descriptor.hpp"
#include "runtime.hpp"
#include "taps.hpp"

namespace {

using fiona::host::GroupClock;
using fiona::host::Mailbox;
using fiona::host::Runtime;

constexpr int kGroupSocket = 3;
constexpr int kClockSocket = 4;
constexpr int kLivenessPage = 5;
constexpr int kAdoptionSocket = 6;
/// Unsent bytes above which a host is slow, and events wait: of watched values so many as the mailbox holds.
constexpr std::size_t kSlowHost = 1024 * 1024;
constexpr std::chrono::seconds kWelcomeDeadline{5};
/// Once it has nobody left, whatever its components do.
constexpr std::chrono::seconds kEndsWithin{4};
/// For the supervisor to start another host: its back-off, and what a slow machine adds. It ends by itself then.
constexpr std::chrono::seconds kAdoptedWithin{20};

/// What a process that was stopped finds before it: whoever asked has been told that it was not done.
bool has_expired(const fiona::wire::GroupRequest& request) {
  return request.expires_ns() != 0 &&
         std::chrono::steady_clock::now().time_since_epoch() > std::chrono::nanoseconds(request.expires_ns());
}

fiona::wire::GroupMessage expired() {
  fiona::wire::GroupMessage reply;
  *reply.mutable_failure() = fiona::host::failure_of(
      fiona::Error(fiona::ErrorCode::Unreachable, {.what = "nobody waits for that any more", .next = "ask again"}));
  return reply;
}

/// Does one request; a virtual clock is told of its beginning and end.
fiona::wire::GroupMessage handle(Runtime& runtime, GroupClock* clock, const fiona::wire::GroupRequest& request) {
  if (clock) clock->begin_request(fiona::TimePoint(fiona::Duration(request.now_ns())));
  auto reply = has_expired(request) ? expired() : runtime.handle(request);
  reply.set_id(request.id());
  if (clock) clock->end_request(request.id());
  return reply;
}

/// To a host that reads slowly, slowly: it goes on, or ends. Instead of an answer that is too large goes a refusal,
/// instead of an event that is nothing, for it has been counted. False: the host has gone.
bool tell(fiona::os::MessageStream& stream, fiona::wire::GroupMessage message) {
  if (!fiona::os::MessageStream::fits(message)) {
    const auto error = fiona::host::too_large(message);
    const auto id = message.id();
    message.Clear();
    if (id == 0) std::cerr << error.text().what << ": " << error.text().found << "\n";
    if (id != 0) *message.mutable_failure() = fiona::host::failure_of(error);
    message.set_id(id);
  }
  return (stream.unsent() <= kSlowHost || stream.flush_all()) && stream.send(message);
}

int serve(Runtime& runtime, const fiona::host::PluginLibraries& libraries, GroupClock* clock,
          fiona::os::MessageStream& stream, Mailbox<fiona::wire::GroupMessage>& events) {
  fiona::os::ReadPages read_pages;
  while (true) {
    pollfd waits[] = {{stream.descriptor(), static_cast<short>(stream.unsent() > 0 ? POLLIN | POLLOUT : POLLIN), 0},
                      {events.descriptor(), POLLIN, 0}};
    const bool is_slow = stream.unsent() > kSlowHost;
    ::poll(waits, is_slow ? 1 : 2, read_pages.look(libraries.size()));
    runtime.let_failed_go();
    if (!is_slow) {
      for (auto& event : events.take()) {
        if (!tell(stream, std::move(event))) return 1;
      }
    }
    if (!stream.flush() || !stream.receive()) return 0;
    fiona::wire::GroupRequest request;
    while (stream.next(request)) {
      auto reply = handle(runtime, clock, request);
      // What the request caused is told before its answer.
      for (auto& event : events.take()) tell(stream, std::move(event));
      if (!tell(stream, std::move(reply))) return 1;
    }
  }
}

/// What nobody waits for any more: it was asked for by the host that is gone.
bool was_asked_for(const fiona::wire::GroupMessage& event) {
  return event.has_tapped() || event.has_tap_ended() || event.has_mode_set() || event.has_call_ended();
}

/// The socket to the next host; none: there is nobody who could bring one. Who uses what fails meanwhile is told.
std::unique_ptr<fiona::os::MessageStream> next_host(const fiona::os::PacketSocket& adoption, Runtime& runtime) {
  using Got = fiona::os::PacketSocket::Got;
  const auto end = std::chrono::steady_clock::now() + kAdoptedWithin;
  fiona::os::Packet packet;
  Got got = Got::Nothing;
  while (got == Got::Nothing && std::chrono::steady_clock::now() < end) {
    pollfd wait{adoption.descriptor(), POLLIN, 0};
    ::poll(&wait, 1, static_cast<int>(fiona::host::kWatchEvery.count()));
    runtime.let_failed_go();
    got = adoption.receive(packet);
  }
  if (got != Got::Packet) return nullptr;
  if (packet.descriptors.size() != 1) return nullptr;
  return std::make_unique<fiona::os::MessageStream>(std::move(packet.descriptors.front()));
}

/// One host after the other: its wires to other groups go on between two.
int serve_hosts(Runtime& runtime, const fiona::host::PluginLibraries& libraries,
                std::unique_ptr<fiona::os::MessageStream> stream, Mailbox<fiona::wire::GroupMessage>& events,
                const std::string& host) {
  const fiona::os::PacketSocket adoption{fiona::os::Descriptor(kAdoptionSocket)};
  while (stream) {
    serve(runtime, libraries, nullptr, *stream, events);
    stream.reset();
    runtime.host_lost(host);
    stream = next_host(adoption, runtime);
    for (auto& event : events.take()) {
      if (!was_asked_for(event)) events.push(std::move(event));
    }
  }
  return 0;
}

using Words = std::vector<std::string>;

std::string value_of(const Words& words, std::string_view flag) {
  const auto found = std::find(words.begin(), words.end(), flag);
  if (found != words.end() && found + 1 != words.end()) return found[1];
  throw fiona::Error(fiona::ErrorCode::Usage,
                     {.what = "fiona-group is started by fiona-host, which gives it " + std::string(flag),
                      .next = "fiona run starts a host, and load … in GROUP a group"});
}

std::unique_ptr<fiona::Clock> make_clock(const Words& words) {
  const std::int64_t start_ns = std::stoll(value_of(words, "--clock-start"));
  if (value_of(words, "--clock") == "virtual") {
    return std::make_unique<GroupClock>(fiona::os::Descriptor(kClockSocket),
                                        fiona::TimePoint(fiona::Duration(start_ns)));
  }
  return std::make_unique<fiona::SystemClock>(
      fiona::SystemClock::Origin{std::stoll(value_of(words, "--clock-origin")), start_ns});
}

/// The key of this process's links, the first thing that the host says.
fiona::wire::Welcome welcome_from(fiona::os::MessageStream& stream) {
  const auto end = std::chrono::steady_clock::now() + kWelcomeDeadline;
  fiona::wire::GroupRequest request;
  while (!stream.next(request)) {
    if (stream.wait_readable(end) && stream.receive()) continue;
    throw fiona::Error(fiona::ErrorCode::Unreachable,
                       {.what = "the host has not said what this group's links are opened with",
                        .next = "see why the host stands still or has ended: its last lines, and doctor"});
  }
  return request.welcome();
}

/// Libraries that another process wants to open: of each its path, hash and size.
int try_libraries(int argc, char** argv) {
  fiona::host::PluginLibraries::Files files;
  for (int i = 2; i + 2 < argc; i += 3) {
    auto& file = *files.Add();
    file.set_path(argv[i]);
    file.set_blake2b(argv[i + 1]);
    file.set_size(std::stoull(argv[i + 2]));
  }
  const std::string verdict = fiona::host::PluginLibraries().tried(files);
  const bool told = ::write(kGroupSocket, verdict.data(), verdict.size()) > 0;
  ::_exit(told ? 0 : 1);  // without what its destructors do
}

/// Before the first thread: what binds one binds those that it starts.
void confine(const fiona::wire::Confinement& confinement, fiona::wire::Ready& ready) {
  fiona::os::limit({confinement.memory(), confinement.threads(), confinement.descriptors()});
  if (!confinement.sandboxed()) return;
  fiona::os::Reach reach;
  reach.readable.assign(confinement.readable().begin(), confinement.readable().end());
  reach.writable.assign(confinement.writable().begin(), confinement.writable().end());
  reach.socket_folders.assign(confinement.socket_folders().begin(), confinement.socket_folders().end());
  reach.devices.assign(confinement.devices().begin(), confinement.devices().end());
  reach.hidden.assign(confinement.hidden().begin(), confinement.hidden().end());
  reach.network = confinement.network();
  if (!confinement.buses().empty()) reach.readable.emplace_back(confinement.buses());
  const std::string bus = "unix:path=" + confinement.buses() + "/";
  if (confinement.system_bus_size() > 0) ::setenv("DBUS_SYSTEM_BUS_ADDRESS", (bus + "system").c_str(), 1);
  if (confinement.session_bus_size() > 0) ::setenv("DBUS_SESSION_BUS_ADDRESS", (bus + "session").c_str(), 1);
  for (const auto& file : confinement.libraries()) {
    const auto sealed = std::make_shared<fiona::host::SealedLibrary>(file);
    reach.copies.push_back({file.path(), file.size(), [sealed](const auto& to) { sealed->write_to(to); }});
  }
  for (const auto& layer : fiona::os::confine(reach)) {
    auto& told = *ready.add_sandbox();
    told.set_name(layer.name);
    told.set_detail(layer.detail);
    told.set_missing(layer.missing);
  }
}

std::string cpu_obstacle() {
  try {
    fiona::os::require_cpu_groups(fiona::os::cpu_groups());
    return {};
  } catch (const std::runtime_error& obstacle) {
    return obstacle.what();
  }
}

/// What a sandbox would be made of here, and what holds groups to their share of the CPU, for people.
int probe_sandbox() {
  const auto proxy = fiona::os::program_in_path(fiona::os::kBusProxy);
  const std::string cpu = cpu_obstacle();
  for (const auto& layer : fiona::os::confine({})) {
    std::cout << layer.name << ": " << (layer.missing.empty() ? layer.detail : "missing: " + layer.missing) << "\n";
  }
  std::cout << fiona::os::kBusProxy << ": " << (proxy.empty() ? "missing: apt-get install " : proxy.string())
            << (proxy.empty() ? fiona::os::kBusProxy : "") << "\n";
  std::cout << "cpu share: " << (cpu.empty() ? "control groups" : "missing: " + cpu) << "\n";
  std::cout.flush();
  ::_exit(0);  // what would run at the end, a leak check above all, needs what was given up
}

/// What a library declares, into a file.
void describe_into(const fiona::os::Descriptor& out, const std::string& library,
                   const std::vector<std::string>& brought) {
  std::string text;
  google::protobuf::TextFormat::PrintToString(fiona::tools::interface_of_library(library, brought), &text);
  for (std::size_t written = 0; written < text.size();) {
    const ssize_t now = ::write(out.get(), text.data() + written, text.size() - written);
    if (now <= 0)
      throw fiona::Error(fiona::ErrorCode::Failed, {.what = "the interface cannot be written",
                                                    .next = "see why who reads it has ended: its last lines"});
    written += static_cast<std::size_t>(now);
  }
}

/// fiona-group --describe confined|unconfined FILE LIBRARY [BROUGHT …]: the library's code runs in a sandbox which has
/// the library, those that it brings along, and nothing else in reach. Before it runs, a line says what of the sandbox
/// is missing, or nothing: what comes later may be the library's own words.
[[noreturn]] void describe_library(int argc, char** argv) {
  const fiona::os::Descriptor out(::open(argv[3], O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600));
  const std::string library = std::filesystem::canonical(argv[4]);
  fiona::os::Reach reach;
  for (int i = 4; i < argc; ++i) reach.readable.push_back(std::filesystem::canonical(argv[i]));
  const std::vector<std::string> brought(reach.readable.begin() + 1, reach.readable.end());
  fiona::os::limit({});
  int code = 0;  // the process ends without what destructors, and a leak check, would do in a sandbox
  if (argv[2] == std::string_view("confined")) {
    const auto layers = fiona::os::confine(reach);
    const auto* missing = fiona::os::missing_wall(layers);
    std::cout << (missing ? missing->name + ": " + missing->missing : "") << std::endl;
    if (missing) ::_exit(static_cast<int>(fiona::ErrorCode::NotAllowed));
  }
  try {
    describe_into(out, library, brought);
  } catch (const std::exception& error) {
    std::cerr << error.what() << std::endl;
    code = 1;
  }
  ::_exit(code);
}

/// What a component does on the thread that serves the host may never end: then this process does not either once the
/// host is gone, and with `adoptable` who could bring another one, unless somebody else looks.
void end_without_host(bool adoptable, bool sandboxed) {
  const int watched = ::fcntl(adoptable ? kAdoptionSocket : kGroupSocket, F_DUPFD_CLOEXEC, 0);
  std::thread([watched, sandboxed] {
    pollfd gone{watched, 0, 0};  // POLLHUP alone
    while (::poll(&gone, 1, -1) <= 0) {
    }
    std::this_thread::sleep_for(kEndsWithin + std::chrono::milliseconds(500));
    if (!sandboxed) fiona::os::end_own_programs();
    ::_exit(1);
  }).detach();
}

/// Who ends all processes of a session or service at once means the host too, which ends its groups in order. Handlers,
/// unlike signals that are ignored or blocked, are not handed down to what components start.
void leave_the_end_to_the_host() {
  for (const int one : {SIGINT, SIGTERM}) ::signal(one, [](int) {});
}

int be_group(const Words& words) {
  leave_the_end_to_the_host();
  const std::string endpoint = value_of(words, "--endpoint");
  auto stream = std::make_unique<fiona::os::MessageStream>(fiona::os::Descriptor(kGroupSocket));
  const auto welcome = welcome_from(*stream);
  fiona::wire::GroupMessage ready;
  confine(welcome.confinement(), *ready.mutable_ready());
  fiona::os::keep_spare_descriptor();  // now: to confine closes what is open
  end_without_host(welcome.adoptable(), welcome.confinement().sandboxed());
  const auto clock = make_clock(words);
  auto* const follower = dynamic_cast<GroupClock*>(clock.get());
  const fiona::os::SharedMemory page(fiona::os::Descriptor(kLivenessPage), sizeof(fiona::Liveness::Page));
  const auto liveness = std::make_shared<fiona::Liveness>(*static_cast<fiona::Liveness::Page*>(page.data()));
  fiona::Pool pool(std::stoul(value_of(words, "--threads")), liveness);
  Mailbox<fiona::wire::GroupMessage> events;
  fiona::host::PluginLibraries libraries(welcome.confinement().sandboxed());
  Runtime runtime(pool, *clock, libraries, endpoint, {welcome.key(), welcome.memory_key()}, Runtime::Watched::ByItsHost,
                  [&events, follower](fiona::wire::GroupMessage event) {
                    // Counted first: virtual time waits until the host has seen what was counted, so that none may be
                    // dropped. What one instant puts bounds them.
                    if (follower) follower->count_event();
                    follower ? events.push(std::move(event)) : fiona::host::push_event(events, std::move(event));
                  });
  ready.mutable_ready()->set_endpoint(endpoint);
  ready.mutable_ready()->set_protocol(fiona::host::kGroupProtocol);
  if (!stream->send(ready)) return 1;
  if (follower) follower->follow([&runtime] { return runtime.frame_counts(); });
  const int code = welcome.adoptable() ? serve_hosts(runtime, libraries, std::move(stream), events, welcome.host())
                                       : serve(runtime, libraries, follower, *stream, events);
  fiona::os::end_within(kEndsWithin, code);
  if (!welcome.confinement().sandboxed()) fiona::os::end_own_programs();  // a host that was killed does not do it
  clock->stop();
  return code;
}

int run(int argc, char** argv) {
  if (argc >= 5 && argv[1] == std::string_view("--describe")) describe_library(argc, argv);
  if (argc == 2 && argv[1] == std::string_view("--probe")) return probe_sandbox();
  if (argc >= 5 && argv[1] == std::string_view("--try")) return try_libraries(argc, argv);
  if (fiona::os::is_template(argc, argv)) return be_group(fiona::os::wait_to_be_copied(argc, argv));
  return be_group(Words(argv + 1, argv + argc));
}

}  // namespace

int main(int argc, char** argv) {
  // What a peer garbles is counted where it is refused; the library would write a line for each message.
  google::protobuf::SetLogHandler(nullptr);
  fiona::os::keep_freed_memory();
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << "fiona-group: " << error.what() << "\n";
    return 1;
  }
}
