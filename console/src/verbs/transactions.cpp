// begin, commit, abort, plan, apply, swap, undo, journal: changes as a whole, and taken back.
#include <ctime>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include "../catalogue.hpp"
#include "../changes.hpp"
#include "../script.hpp"
#include "../table.hpp"
#include "../verb_table.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

/// For a host to make way, with what is in its `main`, and for the next one to be there.
constexpr std::chrono::seconds kNextHostWithin{30};
constexpr std::chrono::milliseconds kRetryPeriod{50};
/// How long another build of the host is on trial, where nobody says.
constexpr double kHostWatch_ms = 10'000;

/// Collects what the lines of `run` ask for instead of making it.
template <class Run>
Batch collected(Session& session, const Run& run) {
  auto before = std::exchange(session.batch, Batch{});
  try {
    run();
  } catch (...) {
    session.batch = std::move(before);
    throw;
  }
  return *std::exchange(session.batch, std::move(before));
}

/// Whether a line tells what a system consists of; those that only look are passed over.
bool composes(const Line& line) {
  const std::string& name = line.verb.text;
  if (name == "begin" || name == "commit") return false;  // the whole file is one transaction
  if (name == "abort")
    throw line.error(line.verb,
                     {.what = "'abort' drops what the lines since 'begin' have asked for, and all of a file is applied",
                      .next = "take these lines out; or: source FILE"});
  const Verb& verb = *find_verb(line.verb.text);
  if (verb.access == Access::Observe && verb.in_transaction) return false;
  if (verb.in_transaction) return true;
  throw line.error(line.verb, {.what = fmt::format("'{}' tells nothing of what a system consists of", line.verb.text),
                               .expected = "load, wire, set, state",
                               .next = "source FILE runs all its lines"});
}

/// The rest of a line that begins with another line's verb.
Line inner_line(const Line& line) {
  WordLine words = line.words;
  words.items.erase(words.items.begin());
  if (!words.empty()) return read_line(words);
  throw line.error(line.verb, {.what = "a line is missing", .expected = "plan LINE, as in: plan swap old for new"});
}

std::string time_text(std::int64_t time_ms) {
  const std::time_t seconds = time_ms / 1000;
  std::tm local{};
  ::localtime_r(&seconds, &local);
  return fmt::format("{:%H:%M:%S}", local);
}

std::string state_text(const control::JournalEntry& entry) {
  switch (entry.state()) {
    case control::JournalEntry::UNDER_WAY: return "under way";
    case control::JournalEntry::DONE: return entry.undoes() == 0 ? "done" : fmt::format("undid {}", entry.undoes());
    case control::JournalEntry::ROLLED_BACK: return "rolled back";
    case control::JournalEntry::UNDONE: return "undone";
    default: return "?";
  }
}

/// Until a host answers at the same place. Throws Error if none does.
void come_back(Session& session, const Endpoint& endpoint) {
  const SteadyTime end = std::chrono::steady_clock::now() + kNextHostWithin;
  const auto pause = [&session] {
    session.reactor.run_until([] { return false; }, std::chrono::steady_clock::now() + kRetryPeriod);
  };
  for (session.lose_host(); !session.connected(); pause()) {
    try {
      if (endpoint.remote || answers(endpoint.socket)) session.connect(endpoint);
    } catch (const Error&) {  // it is not there yet
    }
    if (!session.connected() && std::chrono::steady_clock::now() >= end)
      throw Error(ErrorCode::Unreachable, ErrorText{.what = "no host answers after the upgrade",
                                                    .where = endpoint.text(),
                                                    .next = "what `fiona run` has said tells why"});
  }
}

/// The system once the new host is on trial no more, or the one before is back.
control::System after_trial(Session& session, const Endpoint& endpoint, double trial_ms) {
  std::optional<SteadyTime> end;
  while (true) {
    if (!session.connected()) come_back(session, endpoint);
    const SteadyTime now = std::chrono::steady_clock::now();
    if (!end) end = now + std::chrono::milliseconds(static_cast<std::int64_t>(trial_ms));
    try {
      control::System system = session.snapshot();
      if (system.taken_back() || now >= *end) return system;
      session.reactor.run_until([&session] { return !session.connected(); }, *end);
    } catch (const Error&) {  // it has ended meanwhile; where nobody follows, that is what is told
      session.lose_host();
    }
  }
}

/// The host, by another build of itself: this one ends, and the next answers at the same place. It is waited for until
/// it is on trial no more.
void upgrade_host(Session& session, const Line& line) {
  if (session.planning || session.batch)
    throw line.error(line.verb, {.what = "a host's upgrade is no change of the system, and is not planned or collected",
                                 .next = "upgrade host, in a line of its own"});
  const Word* watch = line.clause("watch");
  const double watch_ms = watch != nullptr ? duration_ms(*watch, line.words) : kHostWatch_ms;
  const Endpoint endpoint = session.host().endpoint();
  control::Request request;
  request.mutable_upgrade_host()->set_watch_ms(watch_ms);
  session.host().call_waiting(std::move(request));
  session.reactor.run_until([&session] { return !session.connected(); },
                            std::chrono::steady_clock::now() + kNextHostWithin);
  const control::System now = after_trial(session, endpoint, watch_ms);
  if (now.taken_back())
    throw line.error(line.verb,
                     {.what = "the host was not upgraded",
                      .found = now.restart_reason(),
                      .next = "install FIONA again, then: upgrade host"},
                     ErrorCode::Failed);
  session.out.done(fmt::format("upgraded host {}: version {}", now.host(), now.version()));
}

}  // namespace

void swap(Session& session, const Line& line) {
  control::Change change;
  change.mutable_replace()->set_old(line.positional[0].text);
  change.mutable_replace()->set_next(line.clause("for")->text);
  if (const Word* watch = line.clause("watch")) change.mutable_replace()->set_watch_ms(duration_ms(*watch, line.words));
  make(session, line, std::move(change), fmt::format("swapped {}", line.positional[0].text));
}

void upgrade(Session& session, const Line& line) {
  if (line.positional[0].is_plain("host")) return upgrade_host(session, line);
  control::Change change;
  control::Upgrade& upgrade = *change.mutable_upgrade();
  upgrade.set_instance(line.positional[0].text);
  if (const Word* version = line.clause("to")) upgrade.set_version(version->text);
  if (const Word* watch = line.clause("watch")) upgrade.set_watch_ms(duration_ms(*watch, line.words));
  make(session, line, std::move(change), fmt::format("upgraded {}", line.positional[0].text));
}

void begin(Session& session, const Line& line) {
  if (session.batch)
    throw line.error(line.verb, {.what = "a transaction has begun already", .next = "commit, or abort"});
  if (session.setting == Setting::Shell)
    throw line.error(line.verb, {.what = "a line of a shell is a transaction of its own",
                                 .next = "begin and commit belong to a prompt or a system file"});
  session.batch = Batch{};
}

void commit(Session& session, const Line& line) {
  if (!session.batch) throw line.error(line.verb, {.what = "no transaction has begun", .next = "begin"});
  const Batch batch = *std::exchange(session.batch, std::nullopt);
  make(session, batch, false);
}

void abort(Session& session, const Line& line) {
  if (!session.batch) throw line.error(line.verb, {.what = "no transaction has begun", .next = "begin"});
  const Batch batch = *std::exchange(session.batch, std::nullopt);
  session.out.done(fmt::format("dropped {} change{}", batch.changes.size(), batch.changes.size() == 1 ? "" : "s"));
}

void plan(Session& session, const Line& line) {
  const Line inner = inner_line(line);
  const auto planning = std::exchange(session.planning, true);
  try {
    if (inner.verb.text == "apply" || inner.verb.text == "undo" || inner.verb.text == "market") {
      find_verb(inner.verb.text)->handler(session, inner);
    } else {
      const Verb& verb = *find_verb(inner.verb.text);
      const bool looks = verb.access == Access::Observe;
      const bool alone = inner.verb.text == "upgrade";  // no part of a transaction, but its change can be planned
      const bool bounds = inner.verb.text == "begin" || inner.verb.text == "commit" || inner.verb.text == "abort";
      if (bounds || (!looks && !alone && !verb.in_transaction))
        throw line.error(inner.verb, {.what = fmt::format("'{}' is no change of the system: there is nothing to plan",
                                                          inner.verb.text),
                                      .expected = "a line that load, wire, set, apply, undo, market … begins",
                                      .next = "help plan"});
      const Batch batch = looks ? Batch{} : collected(session, [&] {
        alone ? find_verb(inner.verb.text)->handler(session, inner) : session.run(inner);
      });
      if (batch.changes.empty())
        throw line.error(inner.verb, {.what = fmt::format("'{}' changes nothing", inner.verb.text),
                                      .next = "there is nothing to do"});
      make(session, batch, false);
    }
  } catch (...) {
    session.planning = planning;
    throw;
  }
  session.planning = planning;
}

void apply(Session& session, const Line& line) {
  const std::vector<Line> lines = read_script(system_path(line.positional[0].text, session.options.store));
  const Batch batch = collected(session, [&] {
    for (const Line& one : lines) {
      if (composes(one)) session.run(one);
    }
  });
  make(session, batch, true);
}

void undo(Session& session, const Line&) {
  control::Request request;
  request.mutable_undo()->set_dry_run(session.planning);
  tell(session, session.host().call_waiting(std::move(request)), "undone");
}

void journal(Session& session, const Line& line) {
  control::Request request;
  request.mutable_journal()->set_last(line.positional.empty() ? 20 : count_of(line.positional[0], line.words));
  const control::Reply reply = session.call(std::move(request));
  Table table({"entry", "time", "author", "state", "change"});
  for (const auto& entry : reply.journal().entries()) {
    std::vector<std::string> lines;
    for (const auto& step : entry.steps()) lines.push_back(line_of(step));
    std::string what = lines.empty() ? "" : lines.front();
    if (lines.size() > 1) what += fmt::format(" (and {} more)", lines.size() - 1);
    if (!entry.reason().empty()) what += ": " + entry.reason();
    table.add({{fmt::format("{}", entry.number()), entry.number()},
               {time_text(entry.time_ms()), entry.time_ms() / 1000},
               entry.author(),
               state_text(entry),
               {what, lines}});
  }
  session.out.table(table, "nothing has been changed yet");
}

}  // namespace fiona::console::verbs
