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

}  // namespace

void swap(Session& session, const Line& line) {
  control::Change change;
  change.mutable_replace()->set_old(line.positional[0].text);
  change.mutable_replace()->set_next(line.clause("for")->text);
  if (const Word* watch = line.clause("watch")) change.mutable_replace()->set_watch_ms(duration_ms(*watch, line.words));
  make(session, line, std::move(change), fmt::format("swapped {}", line.positional[0].text));
}

void upgrade(Session& session, const Line& line) {
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
      const bool looks = find_verb(inner.verb.text)->access == Access::Observe;
      const bool alone = inner.verb.text == "upgrade";  // no part of a transaction, but its change can be planned
      const Batch batch = looks ? Batch{} : collected(session, [&] {
        alone ? find_verb(inner.verb.text)->handler(session, inner) : session.run(inner);
      });
      if (batch.changes.empty())
        throw line.error(inner.verb, {.what = fmt::format("'{}' changes nothing", inner.verb.text)});
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
               {time_text(entry.time_ms()), entry.time_ms()},
               entry.author(),
               state_text(entry),
               {what, lines}});
  }
  session.out.table(table, "nothing has been changed yet");
}

}  // namespace fiona::console::verbs
