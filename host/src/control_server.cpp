#include "control_server.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <bit>
#include <cstdio>
#include <ctime>
#include <iostream>
#include <set>
#include <vector>

#include "failure.hpp"
#include "fiona/error.hpp"
#include "fiona/readable_text.hpp"
#include "taps.hpp"

namespace fiona::host {
namespace {

/// Consoles and pages at once, beside those over tcp; further ones are turned away.
constexpr std::size_t kMaxClients = 64 + RemoteConsoles::kMost;
/// What may wait to be done for those over tcp.
constexpr std::size_t kMaxRemoteWork = 1000;
/// Requests of one client that are answered later, and its watches.
constexpr std::size_t kMaxOpen = 1000;
/// For which the requests of one client are done before it is the turn of what else there is.
constexpr std::chrono::milliseconds kTurn{2};
/// Of what a console over tcp says for the journal.
constexpr std::size_t kMaxAuthor = 100;
std::filesystem::path journal_of(std::filesystem::path socket) { return socket.replace_extension(".journal"); }

/// Of a change whose turn has not come by then; none: it waits for it.
std::optional<std::chrono::milliseconds> deadline_of(const control::Request& request) {
  if (request.deadline_ms() == 0) return std::nullopt;
  return std::chrono::milliseconds(request.deadline_ms());
}

/// "2026-05-17 14:03:12", by the machine's clock.
std::string text_of_time(std::int64_t ms) {
  const std::time_t seconds = ms / 1000;
  std::tm parts{};
  return fmt::format("{:%F %T}", *::localtime_r(&seconds, &parts));
}

/// Of instances that have said something, before those are looked for that are gone.
constexpr std::size_t kMostNames = 4096;

/// Unsent bytes above which a slow watcher loses samples, counted.
constexpr std::size_t kSlowWatcher = 1024 * 1024;
/// How often a virtual clock is looked at.
constexpr int kTimeWatch_ms = 500;
/// For the first connections to the hosts that this one leads.
constexpr std::chrono::seconds kMeetsWithin{2};
constexpr int kMeeting_ms = 20;

/// What a component has said, as one record: its further lines are indented, so that none can be taken for another's.
std::string record_of(const std::string& instance, const std::string& text) {
  std::string record = instance + ": ";
  for (const char c : text) record += c == '\n' ? std::string("\n    ") : std::string(1, c);
  return record + "\n";
}

}  // namespace

struct ControlServer::Client {
  Client(os::Descriptor socket, Rights given) : stream(std::move(socket)), rights(std::move(given)) {}
  /// One that does not read is cut off.
  void tell(control::Reply reply) {
    if (!os::MessageStream::fits(reply)) *reply.mutable_failure() = failure_of(too_large(reply));
    if (stream.send(reply)) return;
    cut_off = cut_off || !stream.closed();
    stream.shut_down();
  }
  os::MessageStream stream;
  const Rights rights;
  bool cut_off = false;                 ///< by this host: nothing more is done for it
  std::size_t held_bytes = 0;           ///< of what it watches
  std::multiset<std::uint64_t> open{};  ///< requests that are answered later, and watches
};

ControlServer::ControlServer(const std::filesystem::path& socket, System::Options options, bool restore,
                             const std::filesystem::path& journal)
    : listener_(socket),
      remote_(serve_remote(options)),
      system_(std::move(options), [this](const wire::GroupMessage& event) { push_event(events_, event); }),
      told_(restore ? std::optional(Journal::read(journal.empty() ? journal_of(socket) : journal)) : std::nullopt),
      engine_(
          system_, journal.empty() ? journal_of(socket) : journal,
          [this](std::function<void()> work) { work_.push(std::move(work)); }, told_),
      masters_(system_, engine_, [this](std::function<void()> work) { work_.push(std::move(work)); }) {
  if (told_) this->restore(journal.empty() ? journal_of(socket) : journal);
}

ControlServer::~ControlServer() = default;

std::unique_ptr<RemoteConsoles> ControlServer::serve_remote(const System::Options& options) {
  if (options.hosts.serve.empty()) return nullptr;
  const auto on_console = [this](os::Descriptor socket, const Rights& rights) {
    // Closed where it cannot be handed on, which tells the console.
    const auto handed = std::make_shared<os::Descriptor>(std::move(socket));
    work_.push([this, handed, rights] { add_client(std::move(*handed), rights); }, kMaxRemoteWork);
  };
  const auto on_log = [this](const std::string& text) {
    work_.push([text] { std::cerr << text << "\n"; }, kMaxRemoteWork);
  };
  return std::make_unique<RemoteConsoles>(options.hosts.serve, trust::KeyDirectory(options.hosts.keys), options.name,
                                          on_console, on_log);
}

void ControlServer::add_client(os::Descriptor socket, Rights rights) {
  system_.waits().meet(next_client_);
  clients_.emplace(next_client_++, std::make_unique<Client>(std::move(socket), std::move(rights)));
}

/// The system as a journal tells of it is made before the host says that it is there.
void ControlServer::restore(const std::filesystem::path& journal) {
  const Journal::Told told = *std::exchange(told_, std::nullopt);
  const std::string until = text_of_time(told.last_ms);
  if (told.older) {
    std::cerr << journal.string() << ": none of its " << told.damaged << " bytes can be read: the system is that of "
              << journal.filename().string() << ".old, whose last change was at " << until << "\n";
  } else if (told.damaged > 0) {
    std::cerr << journal.string() << ": the last " << told.damaged << " of " << told.bytes + told.damaged
              << " bytes cannot be read: changes after " << until << " are not restored\n";
  }
  for (const auto& line : system_.resume(told.changes)) std::cerr << line << "\n";
}

/// As somebody has asked for.
void ControlServer::end(int code, const std::string& why) {
  exit_code_ = code;
  end_reason_ = why;
  was_ended_ = true;
  if (system_.supervisor()) system_.supervisor()->quits();
}

/// What they say at their end, consoles are told before that of the run. Who watches sees the host end, and nothing
/// unloaded.
void ControlServer::end_instances() {
  system_.end_instances();
  for (const auto& event : events_.take()) {
    if (!event.has_tap_ended()) on_event(event);
  }
}

void ControlServer::meet_peers(int lifeline, int signals) {
  const auto end = std::chrono::steady_clock::now() + kMeetsWithin;
  while (!exit_code_ && !system_.has_met_peers() && std::chrono::steady_clock::now() < end)
    poll_once(lifeline, signals, kMeeting_ms);
}

int ControlServer::serve(int lifeline, int signals, const std::function<void(int code)>& ends) {
  while (!exit_code_) poll_once(lifeline, signals);
  if (ends) ends(*exit_code_);
  // With a supervisor the run goes on at the next host, unless its end was meant.
  if (!system_.supervisor() || was_ended_) {
    if (!has_kept_threads()) end_instances();
    system_.waits().end_run(*exit_code_, end_reason_);
  }
  for (auto& [client, reply] : outgoing_.take()) send_last(client, reply);
  for (auto& [id, client] : clients_) client->stream.flush();
  return *exit_code_;
}

void ControlServer::poll_once(int lifeline, int signals, int most_ms) {
  std::vector<pollfd> waits{{listener_.descriptor(), POLLIN, 0},
                            {events_.descriptor(), POLLIN, 0},
                            {outgoing_.descriptor(), POLLIN, 0},
                            {lifeline, POLLIN, 0},
                            {signals, POLLIN, 0},
                            {work_.descriptor(), POLLIN, 0},
                            {system_.hosts_descriptor(), POLLIN, 0}};
  const std::size_t fixed = waits.size();
  std::vector<std::uint64_t> ids;
  bool has_more = false;  // of what they said, than was done in their turn
  for (const auto& [id, client] : clients_) {
    ids.push_back(id);
    has_more = has_more || client->stream.has_next();
    const bool writing = client->stream.unsent() > 0;
    waits.push_back({client->stream.descriptor(), static_cast<short>(writing ? POLLIN | POLLOUT : POLLIN), 0});
  }
  std::vector<std::string> groups;  // by name: what is done before one is served may have ended it
  for (const auto* child : system_.child_groups()) {
    groups.push_back(child->name());
    waits.push_back({child->descriptor(), POLLIN, 0});
  }
  const int groups_ms = system_.watches_groups() ? static_cast<int>(kWatchEvery.count()) : -1;
  const int usual_ms = system_.has_virtual_clock() ? kTimeWatch_ms : groups_ms;
  constexpr int kBeat_ms = static_cast<int>(SupervisorLink::kBeatEvery.count());
  const bool beats = system_.supervisor() != nullptr;
  if (beats) system_.supervisor()->beat();
  int wait_ms = most_ms;
  const int pages_ms = read_pages_.look(system_.open_libraries());
  for (const int one : {usual_ms, beats ? kBeat_ms : -1, pages_ms, has_more ? 0 : -1}) {
    if (one >= 0 && (wait_ms < 0 || one < wait_ms)) wait_ms = one;
  }
  if (::poll(waits.data(), waits.size(), wait_ms) < 0) return;
  attempt([this] { system_.watch_time(); });

  if (waits[4].revents != 0) return end(130, "the host was told to end, by a signal");
  if (waits[3].revents != 0) {
    if (!beats || system_.supervisor()->is_told_to_end()) return end(0, "who started the host has ended");
    // Who has started the supervisor may start another one, whose host goes on with the run.
    std::cerr << "the host ends: its supervisor has ended\n";
    exit_code_ = 0;
    return;
  }
  const auto tell = [](const std::vector<std::string>& lines) {
    for (const auto& line : lines) std::cerr << line << "\n";
  };
  for (const auto& event : events_.take()) attempt([&] { on_event(event); });
  for (const auto& work : work_.take()) attempt(work);
  for (const auto& one : outgoing_.take()) attempt([&] { send_last(one.client, one.reply); });
  if (waits[6].revents != 0) attempt([&] { tell(system_.serve_hosts()); });
  for (std::size_t i = 0; i < groups.size(); ++i) {
    if (waits[fixed + ids.size() + i].revents != 0) attempt([&] { system_.serve_group(groups[i]); });
  }
  for (std::size_t i = 0; i < ids.size() && !exit_code_; ++i) {
    const bool waits_for_turn = clients_.contains(ids[i]) && clients_.at(ids[i])->stream.has_next();
    if (waits[fixed + i].revents != 0 || waits_for_turn) attempt([&] { serve_client(ids[i]); });
  }
  attempt([&] { tell(system_.watch_groups()); });
  if (system_.kept_threads() > System::kMostKeptThreads && !exit_code_) {
    end_reason_ = fmt::format("its components have kept {} threads", system_.kept_threads());
    std::cerr << "the host ends: " << end_reason_
              << "; load those that hang in a GROUP, which is ended and started again\n";
    exit_code_ = static_cast<int>(ErrorCode::ComponentFailed);
    if (system_.supervisor()) system_.supervisor()->ends(end_reason_);
  }
  attempt([this] { send_held(); });
  attempt([this] { masters_.end_left(); });
  attempt([this] { go_on_with_upgrade(); });
  if (waits[0].revents != 0) attempt([this] { accept_clients(); });
}

/// One piece of work, which ends neither the host nor its groups, whatever it throws. Told at the first, second,
/// fourth, … time.
void ControlServer::attempt(const std::function<void()>& work) {
  const auto fault = fault_of(work);
  if (fault && std::has_single_bit(++faults_)) std::cerr << *fault << "\n  so far: " << faults_ << "\n";
}

void ControlServer::accept_clients() {
  while (auto socket = listener_.accept()) {
    if (clients_.size() >= kMaxClients) {
      turn_away(std::move(socket));
      continue;
    }
    add_client(std::move(socket), {});
  }
}

/// Told why, as the answer to no request.
void ControlServer::turn_away(os::Descriptor socket) {
  control::Reply reply;
  *reply.mutable_failure() =
      failure_of(Error(ErrorCode::Failed,
                       {.what = fmt::format("{} consoles are connected to this host, and no more may be", kMaxClients),
                        .next = "end some of them, or what has started them"}));
  os::MessageStream(std::move(socket)).send(reply);
}

/// For a turn, so that nobody is held up by one who asks for much; the rest is done in the next ones. Nothing more is
/// done for one that was cut off; what came before a client's own end is.
void ControlServer::serve_client(std::uint64_t id) {
  Client& client = *clients_.at(id);
  auto& stream = client.stream;
  const Rights& rights = client.rights;
  if (!stream.has_next() && !stream.closed()) stream.receive();
  stream.flush();
  const auto end = std::chrono::steady_clock::now() + kTurn;
  control::Request request;
  for (bool its_turn = true; its_turn && !exit_code_ && !client.cut_off && stream.next(request);) {
    // The journal tells who it was, and not who it says it was.
    if (rights.is_remote()) request.set_author(rights.name + ": " + readable_text(request.author(), kMaxAuthor));
    perform(id, request);
    its_turn = std::chrono::steady_clock::now() < end;
  }
  if (!stream.fault().empty()) refuse_garbled(id, stream.fault());
  if (stream.closed() && (client.cut_off || !stream.has_next())) drop_client(id);
}

/// Told to who sent it, and in the host's own words at the first, second, fourth, … time: a storm is few lines.
void ControlServer::refuse_garbled(std::uint64_t client, const std::string& found) {
  control::Reply reply;
  *reply.mutable_failure() = failure_of(Error(
      ErrorCode::Usage, {.what = "what came over this connection is no request, and it is closed",
                         .expected = "a length of 4 bytes, little endian, and a fiona.control.Request",
                         .found = found,
                         .next = "see docs/wire-protocol.md; connect again with a client of the host's version"}));
  send(client, reply);
  ++garbled_;
  if (std::has_single_bit(garbled_))
    std::cerr << "a console was refused: " << found << "; connections closed for this so far: " << garbled_ << "\n";
}

void ControlServer::drop_client(std::uint64_t id) {
  system_.waits().drop(id);
  engine_.give_up(id);
  for (auto it = watches_.begin(); it != watches_.end();) {
    if (it->second.client == id) system_.untap(it->first);
    it = it->second.client == id ? watches_.erase(it) : std::next(it);
  }
  for (auto it = expect_taps_.begin(); it != expect_taps_.end();) {
    if (it->first.first == id) system_.untap(it->second);
    it = it->first.first == id ? expect_taps_.erase(it) : std::next(it);
  }
  std::erase_if(attached_, [id](const auto& entry) { return entry.second.first == id; });
  system_.detach_all(id);
  clients_.erase(id);
}

void ControlServer::send(std::uint64_t id, const control::Reply& reply) {
  const auto client = clients_.find(id);
  const auto tap = expect_taps_.find({id, reply.id()});
  const bool goes_on = client != clients_.end() && client->second->open.contains(reply.id());
  if (tap != expect_taps_.end() && !goes_on) {
    system_.untap(tap->second);
    expect_taps_.erase(tap);
  }
  if (client != clients_.end()) client->second->tell(reply);
}

/// What was answered at once has never been among those that are open.
void ControlServer::send_last(std::uint64_t client, const control::Reply& reply) {
  forget_open(client, reply.id());
  send(client, reply);
}

void ControlServer::forget_open(std::uint64_t client, std::uint64_t request) {
  const auto asking = clients_.find(client);
  if (asking == clients_.end()) return;
  auto& open = asking->second->open;
  if (const auto found = open.find(request); found != open.end()) open.erase(found);
}

Waits::Answer ControlServer::answer_to(std::uint64_t client, std::uint64_t request) {
  return [this, client, request](control::Reply reply) {
    reply.set_id(request);
    outgoing_.push({client, std::move(reply)});
  };
}

void ControlServer::perform(std::uint64_t client, const control::Request& request) {
  control::Reply reply;
  bool answered = true;
  try {
    auto& asking = *clients_.at(client);
    require(asking.rights, request);
    if (asking.open.size() >= kMaxOpen && !request.has_unwatch()) {
      throw Error(ErrorCode::Failed, {.what = "this console waits for " + std::to_string(kMaxOpen) + " answers already",
                                      .next = "watch stop"});
    }
    if (asking.open.contains(request.id())) {
      throw Error(ErrorCode::Usage, {.what = "a request of this number is open already, and goes on",
                                     .found = std::to_string(request.id()),
                                     .next = "give each request of a connection a number of its own"});
    }
    system_.settle();
    answered = dispatch(client, request, reply);
    if (!answered) asking.open.insert(request.id());
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
    case Request::kTransact:
      engine_.transact(request.author(), request.transact(), answer_to(client, request.id()), deadline_of(request),
                       clients_.at(client)->rights, {client, request.id()});
      return false;
    case Request::kUndo:
      engine_.undo(request.author(), request.undo(), answer_to(client, request.id()), clients_.at(client)->rights,
                   {client, request.id()});
      return false;
    case Request::kJournal: *reply.mutable_journal() = engine_.journal(request.journal().last()); return true;
    case Request::kSnapshot:
      *reply.mutable_system() = system_.snapshot();
      if (remote_) remote_->describe(*reply.mutable_system());
      return true;
    case Request::kDescribe:
      *reply.mutable_description() = system_.types().describe(request.describe().name());
      return true;
    case Request::kWatch: start_watch(client, request); return false;
    case Request::kRead: *reply.mutable_sample() = described_sample(system_.read(request.read().probe())); return true;
    case Request::kUnwatch: give_up(client, request.unwatch().watch()); return done("");
    case Request::kWaitMode: return start_wait_mode(client, request, reply);
    case Request::kExpect: start_expect(client, request); return false;
    case Request::kSleep:
      system_.waits().sleep(client, request.id(), request.sleep(), answer_to(client, request.id()));
      return false;
    case Request::kRun: system_.waits().run(client, request.id(), answer_to(client, request.id())); return false;
    case Request::kCall:
      system_.call(client, request.id(), request.call(), answer_to(client, request.id()));
      return false;
    case Request::kAttach:
      *reply.mutable_attached() = system_.attach(client, request.attach());
      attached_[reply.attached().wire()] = {client, request.id()};
      return true;
    case Request::kDetach:
      system_.detach(client, request.detach().wire());
      attached_.erase(request.detach().wire());
      return done("");
    case Request::kUpgradeHost: begin_upgrade(client, request); return false;
    case Request::kQuit: end(request.quit().exit_code(), "quit"); return done("");
    case Request::kNext: break;  // for components
    case Request::WHAT_NOT_SET: break;
  }
  throw Error(ErrorCode::Usage, {.what = "the request is empty, or newer than this host",
                                 .next = "fiona version: console and host are to be of one version"});
}

void ControlServer::begin_upgrade(std::uint64_t client, const control::Request& request) {
  constexpr double kLongest_ms = 600'000;
  const auto& asked = request.upgrade_host();
  const char* why = !system_.supervisor()         ? "it has no supervisor that could start another one"
                    : system_.has_virtual_clock() ? "a run on virtual time ends with its host"
                    : upgrade_ || makes_way_      ? "it is about to be upgraded already"
                                                  : nullptr;
  if (why) {
    throw Error(ErrorCode::Failed,
                {.what = "the host cannot be upgraded while it runs",
                 .found = why,
                 .next = system_.supervisor() ? "wait for that, or quit"
                                              : "save the system, quit, and fiona run --supervised"});
  }
  if (!(asked.watch_ms() >= 0 && asked.watch_ms() <= kLongest_ms))
    throw Error(ErrorCode::Usage, {.what = "a host is not on trial for so long", .expected = "0 s .. 10 min"});
  system_.supervisor()->upgrade(std::chrono::milliseconds(static_cast<std::int64_t>(asked.watch_ms())));
  upgrade_ = {client, request.id()};
}

/// A transaction that is under way is not cut off; nor a change of mode, which may wait for long, for some seconds.
void ControlServer::go_on_with_upgrade() {
  if (!upgrade_) return;
  if (!makes_way_) {
    const auto answer = system_.supervisor()->upgrade_answer();
    if (!answer) return;
    control::Reply reply;
    reply.set_id(upgrade_->second);
    if (answer->empty()) makes_way_ = std::chrono::steady_clock::now();
    if (makes_way_) {
      reply.mutable_done()->set_note("the next host is started");
    } else {
      *reply.mutable_failure() = failure_of(
          Error(ErrorCode::Failed,
                {.what = "the host is not upgraded, and goes on", .found = *answer, .next = "install FIONA again"}));
    }
    send_last(upgrade_->first, reply);
    if (!makes_way_) upgrade_.reset();
  }
  constexpr std::chrono::seconds kForModes{5};
  if (!makes_way_ || !engine_.is_idle()) return;
  if (!engine_.is_at_rest() && std::chrono::steady_clock::now() - *makes_way_ < kForModes) return;
  system_.end_main();
  exit_code_ = 0;
}

void ControlServer::start_watch(std::uint64_t client, const control::Request& request) {
  const std::uint64_t tap = system_.new_tap();
  system_.tap(tap, request.watch());
  watches_[tap] = Watched{.client = client, .request = request.id()};
}

/// A watch ends, what is waited for is let go of, and what has not begun is not made: that is answered.
void ControlServer::give_up(std::uint64_t client, std::uint64_t request) {
  if (!clients_.at(client)->open.contains(request)) return;
  const bool let_go = stop_watch(client, request) || system_.waits().drop(client, request);
  if (let_go) return forget_open(client, request);
  if (engine_.give_up(client, request)) return;
  throw Error(ErrorCode::NotAllowed, {.what = "what was asked for has begun, and goes on", .next = "journal"});
}

bool ControlServer::stop_watch(std::uint64_t client, std::uint64_t request) {
  if (const auto expected = expect_taps_.find({client, request}); expected != expect_taps_.end()) {
    system_.untap(expected->second);
    expect_taps_.erase(expected);
  }
  for (auto it = watches_.begin(); it != watches_.end(); ++it) {
    if (it->second.client != client || it->second.request != request) continue;
    take_held(it->second);
    system_.untap(it->first);
    watches_.erase(it);
    return true;
  }
  return false;
}

void ControlServer::start_expect(std::uint64_t client, const control::Request& request) {
  const control::Expect expect = system_.expected(request.expect());
  const std::uint64_t tap = system_.new_tap();
  const auto begin = [&] {
    control::Watch watch;
    *watch.mutable_port() = expect.port();
    system_.tap(tap, watch);
    expect_taps_[{client, request.id()}] = tap;
  };
  system_.waits().expect(client, request.id(), expect, tap, begin, answer_to(client, request.id()));
}

bool ControlServer::start_wait_mode(std::uint64_t client, const control::Request& request, control::Reply& reply) {
  const auto [there, mode] = system_.has_mode(request.wait_mode().instance(), request.wait_mode().mode());
  if (there) {
    reply.mutable_met()->set_seen(mode);
    return true;
  }
  system_.waits().wait_mode(client, request.id(), request.wait_mode(), answer_to(client, request.id()));
  if (system_.has_virtual_clock()) return false;  // where nothing happens between the two
  // It may have come before it was waited for.
  const auto [now, reached] = system_.has_mode(request.wait_mode().instance(), request.wait_mode().mode());
  if (!now || !system_.waits().drop(client, request.id())) return false;
  reply.mutable_met()->set_seen(reached);
  return true;
}

void ControlServer::on_event(const wire::GroupMessage& event) {
  if (event.has_tapped()) on_tapped(event.tapped());
  if (event.has_tap_ended()) on_tap_ended(event.tap_ended());
  if (event.has_asked()) masters_.serve(event.asked());
  masters_.on_event(event);
  if (event.has_wire_lost()) on_wire_lost(event.wire_lost());
  if (event.has_logged()) write_record(event.logged().instance(), event.logged().text());
  // One that fails while it is being loaded is told to whoever loads it.
  const bool failed = event.has_mode_changed() && event.mode_changed().mode() == kModeFailed;
  if (failed && system_.is_loaded(event.mode_changed().instance())) {
    write_record(event.mode_changed().instance(), "failed: " + event.mode_changed().reason());
  }
}

/// Each process holds its instances to that; one that a component has taken over does not.
void ControlServer::write_record(const std::string& instance, const std::string& text) {
  using Events = InstanceEvents;
  if (said_.size() > kMostNames) std::erase_if(said_, [&](const auto& one) { return !system_.is_loaded(one.first); });
  auto& allowance = said_.try_emplace(instance, 2 * Events::kLinesPerSecond, 2 * Events::kLinesAtOnce).first->second;
  const auto dropped = allowance.take();
  if (!dropped) return;
  if (*dropped > 0) std::cerr << record_of(instance, text_of_dropped(*dropped));
  std::cerr << record_of(instance, readable_text(text, Events::kLongestLine + std::string_view("…").size()));
}

/// Whoever was given its client's end is told.
void ControlServer::on_wire_lost(const wire::WireLost& lost) {
  system_.on_wire_lost(lost.wire(), lost.reason());
  const auto found = attached_.find(lost.wire());
  if (found == attached_.end()) return;
  const auto [client, request] = found->second;
  attached_.erase(found);
  control::Reply reply;
  reply.set_id(request);
  *reply.mutable_failure() = failure_of(
      Error(ErrorCode::Unreachable, {.what = "the wire has ended: " + lost.reason(), .next = "attach again"}));
  send(client, reply);
}

void ControlServer::on_tapped(const wire::Tapped& tapped) {
  const auto found = watches_.find(tapped.tap());
  if (found == watches_.end()) return;
  Watched& watch = found->second;
  if (watch.over || !watch.gaps.takes(tapped)) return;
  const auto client = clients_.find(watch.client);
  if (client == clients_.end()) return;
  take_held(watch);
  if (client->second->stream.unsent() <= kSlowWatcher) return send_sample(watch, *client->second, tapped);
  std::size_t& held = client->second->held_bytes;
  if (held + tapped.object().size() > os::MessageStream::kMaxUnsent) return;
  held += tapped.object().size();
  watch.held = tapped;
}

std::optional<wire::Tapped> ControlServer::take_held(Watched& watch) {
  if (watch.held) clients_.at(watch.client)->held_bytes -= watch.held->object().size();
  return std::exchange(watch.held, std::nullopt);
}

/// A slow watcher has lost samples, and is told how many, but not the newest, as far as there is room for those.
void ControlServer::send_held() {
  for (bool again = true; std::exchange(again, false);) {  // to send one may have made room for those before it
    for (auto next = watches_.begin(); next != watches_.end();) {
      auto& [tap, watch] = *next++;
      if (!watch.held || clients_.at(watch.client)->stream.unsent() > kSlowWatcher) continue;
      send_sample(watch, *clients_.at(watch.client), *take_held(watch));
      if (watch.over) tell_over(tap);
      again = true;
    }
  }
}

void ControlServer::send_sample(Watched& watch, Client& client, const wire::Tapped& tapped) {
  control::Reply reply;
  reply.set_id(watch.request);
  auto& sample = *reply.mutable_sample();
  const bool described = std::exchange(watch.described, watch.described || !tapped.type().empty());
  sample = described ? sample_of(tapped, system_.clock().start()) : described_sample(tapped);
  sample.set_skipped(watch.gaps.before(tapped));
  client.tell(reply);
}

/// With what it takes to read it.
control::Sample ControlServer::described_sample(const wire::Tapped& tapped) {
  control::Sample sample = sample_of(tapped, system_.clock().start());
  const auto object = tapped.type().empty() ? nullptr : system_.types().make(tapped.type());
  if (object) *sample.mutable_files() = Types::files_of(*object->GetDescriptor()->file());
  return sample;
}

/// Behind the newest, which a slow watcher has not been shown yet.
void ControlServer::on_tap_ended(const wire::TapEnded& ended) {
  const auto found = watches_.find(ended.tap());
  if (found == watches_.end()) return;
  found->second.over = ended.failure();
  if (!found->second.held) tell_over(ended.tap());
}

void ControlServer::tell_over(std::uint64_t tap) {
  const auto watch = watches_.extract(tap);
  control::Reply reply;
  reply.set_id(watch.mapped().request);
  *reply.mutable_failure() = *watch.mapped().over;
  send_last(watch.mapped().client, reply);
  system_.untap(tap);
}

}  // namespace fiona::host
