#include "control_server.hpp"

#include <poll.h>
#include <unistd.h>

#include <cstdio>
#include <iostream>
#include <vector>

#include "fiona/error.hpp"

namespace fiona::host {
namespace {

/// Consoles and pages at once; further ones are turned away.
constexpr std::size_t kMaxClients = 64;
/// Events that may wait for the control thread; watched values beyond it are dropped.
constexpr std::size_t kEventBound = 10'000;
/// Unsent bytes above which a slow watcher loses samples, counted.
constexpr std::size_t kSlowWatcher = 1024 * 1024;

}  // namespace

struct ControlServer::Client {
  explicit Client(os::Descriptor socket) : stream(std::move(socket)) {}
  os::MessageStream stream;
};

ControlServer::ControlServer(const std::filesystem::path& socket, System::Options options)
    : listener_(socket),
      system_(std::move(options), [this](const wire::GroupMessage& event) {
        events_.push(event, event.has_tapped() ? kEventBound : SIZE_MAX);
      }) {}

ControlServer::~ControlServer() = default;

int ControlServer::serve(int lifeline, int signals) {
  while (!exit_code_) poll_once(lifeline, signals);
  system_.waits().end_run(*exit_code_, "quit");
  for (auto& [client, reply] : outgoing_.take()) send(client, reply);
  for (auto& [id, client] : clients_) client->stream.flush();
  return *exit_code_;
}

void ControlServer::poll_once(int lifeline, int signals) {
  std::vector<pollfd> waits{{listener_.descriptor(), POLLIN, 0},
                            {events_.descriptor(), POLLIN, 0},
                            {outgoing_.descriptor(), POLLIN, 0},
                            {lifeline, POLLIN, 0},
                            {signals, POLLIN, 0},
                            {system_.hosts_descriptor(), POLLIN, 0}};
  const std::size_t fixed = waits.size();
  std::vector<std::uint64_t> ids;
  for (const auto& [id, client] : clients_) {
    ids.push_back(id);
    const bool writing = client->stream.unsent() > 0;
    waits.push_back({client->stream.descriptor(), static_cast<short>(writing ? POLLIN | POLLOUT : POLLIN), 0});
  }
  const auto children = system_.child_groups();
  for (const auto* child : children) waits.push_back({child->descriptor(), POLLIN, 0});
  if (::poll(waits.data(), waits.size(), -1) < 0) return;

  if (waits[3].revents != 0 || waits[4].revents != 0) {
    exit_code_ = waits[4].revents != 0 ? 130 : 0;
    return;
  }
  for (const auto& event : events_.take()) on_event(event);
  for (auto& [client, reply] : outgoing_.take()) send(client, reply);
  if (waits[5].revents != 0) {
    for (const auto& line : system_.serve_hosts()) std::cerr << line << "\n";
  }
  for (std::size_t i = 0; i < children.size(); ++i) {
    if (waits[fixed + ids.size() + i].revents != 0) system_.serve_group(*children[i]);
  }
  for (std::size_t i = 0; i < ids.size() && !exit_code_; ++i) {
    if (waits[fixed + i].revents != 0) serve_client(ids[i]);
  }
  if (waits[0].revents != 0) accept_clients();
}

void ControlServer::accept_clients() {
  while (auto socket = listener_.accept()) {
    if (clients_.size() >= kMaxClients) continue;
    clients_.emplace(next_client_++, std::make_unique<Client>(std::move(socket)));
  }
}

void ControlServer::serve_client(std::uint64_t id) {
  auto& stream = clients_.at(id)->stream;
  const bool open = stream.receive() && stream.flush();
  control::Request request;
  while (!exit_code_ && stream.next(request)) perform(id, request);
  if (!open || stream.closed()) drop_client(id);
}

void ControlServer::drop_client(std::uint64_t id) {
  system_.waits().drop_owner(id);
  for (auto it = watches_.begin(); it != watches_.end();) {
    if (it->second.client == id) system_.untap(it->first);
    it = it->second.client == id ? watches_.erase(it) : std::next(it);
  }
  for (auto it = expect_taps_.begin(); it != expect_taps_.end();) {
    if (it->first.first == id) system_.untap(it->second);
    it = it->first.first == id ? expect_taps_.erase(it) : std::next(it);
  }
  clients_.erase(id);
}

void ControlServer::send(std::uint64_t id, const control::Reply& reply) {
  if (const auto tap = expect_taps_.find({id, reply.id()}); tap != expect_taps_.end()) {
    system_.untap(tap->second);
    expect_taps_.erase(tap);
  }
  const auto client = clients_.find(id);
  if (client != clients_.end()) client->second->stream.send(reply);
}

Waits::Answer ControlServer::answer_to(std::uint64_t client) {
  return [this, client](control::Reply reply) { outgoing_.push({client, std::move(reply)}); };
}

void ControlServer::perform(std::uint64_t client, const control::Request& request) {
  control::Reply reply;
  bool answered = true;
  try {
    answered = dispatch(client, request, reply);
  } catch (...) {
    *reply.mutable_failure() = failure_of_exception();
  }
  reply.set_id(request.id());
  if (answered) send(client, reply);
}

bool ControlServer::dispatch(std::uint64_t client, const control::Request& request, control::Reply& reply) {
  using Request = control::Request;
  const auto done = [&reply](const std::string& note) {
    reply.mutable_done()->set_note(note);
    return true;
  };
  switch (request.what_case()) {
    case Request::kLoad: return done(system_.load(request.load()));
    case Request::kUnload: return done(system_.unload(request.unload()));
    case Request::kWire: return done(system_.wire(request.wire()));
    case Request::kUnwire: return done(system_.unwire(request.unwire()));
    case Request::kSet: return done(system_.set(request.set()));
    case Request::kState: system_.state(client, request.id(), request.state(), answer_to(client)); return false;
    case Request::kSnapshot: *reply.mutable_system() = system_.snapshot(); return true;
    case Request::kDescribe: *reply.mutable_description() = system_.types().describe(request.describe().name()); return true;
    case Request::kWatch: start_watch(client, request); return false;
    case Request::kUnwatch: stop_watch(client, request.unwatch().watch()); return done("");
    case Request::kWaitMode: return start_wait_mode(client, request, reply);
    case Request::kExpect: start_expect(client, request); return false;
    case Request::kSleep: system_.waits().sleep(client, request.id(), request.sleep(), answer_to(client)); return false;
    case Request::kRun: system_.waits().run(client, request.id(), answer_to(client)); return false;
    case Request::kCall: system_.call(client, request.id(), request.call(), answer_to(client)); return false;
    case Request::kQuit: exit_code_ = request.quit().exit_code(); return done("");
    case Request::WHAT_NOT_SET: break;
  }
  throw Error(ErrorCode::Usage, "the request is empty, or newer than this host");
}

void ControlServer::start_watch(std::uint64_t client, const control::Request& request) {
  const std::uint64_t tap = system_.tap(request.watch().port());
  watches_[tap] = WatchedPort{client, request.id(), request.watch().min_period_ms(), -1e18, 0, false};
}

void ControlServer::stop_watch(std::uint64_t client, std::uint64_t request) {
  for (auto it = watches_.begin(); it != watches_.end(); ++it) {
    if (it->second.client != client || it->second.request != request) continue;
    system_.untap(it->first);
    watches_.erase(it);
    return;
  }
}

void ControlServer::start_expect(std::uint64_t client, const control::Request& request) {
  const std::uint64_t tap = system_.tap(request.expect().port());
  expect_taps_[{client, request.id()}] = tap;
  system_.waits().expect(client, request.id(), request.expect(), tap, answer_to(client));
}

bool ControlServer::start_wait_mode(std::uint64_t client, const control::Request& request, control::Reply& reply) {
  const auto [there, mode] = system_.has_mode(request.wait_mode().instance(), request.wait_mode().mode());
  if (there) {
    reply.mutable_met()->set_seen(mode);
    return true;
  }
  system_.waits().wait_mode(client, request.id(), request.wait_mode(), answer_to(client));
  return false;
}

void ControlServer::on_event(const wire::GroupMessage& event) {
  if (event.has_tapped()) on_tapped(event.tapped());
  if (event.has_wire_lost()) system_.on_wire_lost(event.wire_lost().wire(), event.wire_lost().reason());
  if (event.has_logged()) std::cerr << event.logged().instance() << ": " << event.logged().text() << "\n";
  // One that fails while it is being loaded is told to whoever loads it.
  const bool failed = event.has_mode_changed() && event.mode_changed().mode() == kModeFailed;
  if (failed && system_.has_instance(event.mode_changed().instance())) {
    std::cerr << event.mode_changed().instance() << ": failed: " << event.mode_changed().reason() << "\n";
  }
}

void ControlServer::on_tapped(const wire::Tapped& tapped) {
  const auto found = watches_.find(tapped.tap());
  if (found == watches_.end()) return;
  WatchedPort& watch = found->second;
  const auto client = clients_.find(watch.client);
  if (client == clients_.end()) return;
  const TimePoint origin{Duration(tapped.origin_ns())};
  const double origin_ms = 1e3 * to_seconds(origin - system_.clock().start());
  if (origin_ms - watch.last_ms < watch.min_period_ms || client->second->stream.unsent() > kSlowWatcher) {
    ++watch.skipped;
    return;
  }
  control::Reply reply;
  reply.set_id(watch.request);
  auto& sample = *reply.mutable_sample();
  sample.set_type(tapped.type());
  sample.set_object(tapped.object());
  sample.set_sequence(tapped.sequence());
  sample.set_time_s(origin_ms / 1e3);
  sample.set_age_ms(1e3 * to_seconds(system_.clock().now() - origin));
  sample.set_skipped(std::exchange(watch.skipped, 0));
  watch.last_ms = origin_ms;
  if (!std::exchange(watch.described, true)) {
    if (const auto object = system_.types().make(tapped.type())) {
      *sample.mutable_files() = Types::files_of(*object->GetDescriptor()->file());
    }
  }
  client->second->stream.send(reply);
}

}  // namespace fiona::host
