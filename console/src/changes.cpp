#include "changes.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "grammar.hpp"
#include "system_view.hpp"

namespace fiona::console {
namespace {

std::string typed_port(const control::PortName& name) { return typed_text(name.instance() + "." + name.port()); }

std::string with_arguments(std::string line, const google::protobuf::RepeatedPtrField<control::Argument>& arguments) {
  for (const auto& argument : arguments) line += fmt::format(" {}={}", argument.name(), typed(argument.value()));
  return line;
}

std::string load_line(const control::Load& load) {
  std::string line = "load " + typed_text(load.plugin());
  if (!load.instance().empty()) line += " as " + typed_text(load.instance());
  if (!load.group().empty() && load.group() != "main") line += " in " + typed_text(load.group());
  if (!load.mode().empty()) line += " at " + typed_text(load.mode());
  for (const auto& right : load.rights()) line += " with " + typed_text(right);
  return with_arguments(std::move(line), load.parameters());
}

std::string wire_line(const control::Wire& wire) {
  std::string line = fmt::format("wire {} to {}", typed_port(wire.client()), typed_port(wire.provider()));
  for (const auto& other : wire.alternatives()) line += " else " + typed_port(other);
  if (wire.prescale() > 0) line += fmt::format(" every {}", wire.prescale());
  if (wire.has_hold_ms())
    line += fmt::format(" hold={}{}", wire.hold_ms() / (wire.hold_ms() < 1000 ? 1 : 1000),
                        wire.hold_ms() < 1000 ? "ms" : "s");
  return line;
}

std::vector<std::string> lines_of(const google::protobuf::RepeatedPtrField<control::Change>& changes) {
  std::vector<std::string> lines;
  for (const auto& change : changes) lines.push_back(line_of(change));
  return lines;
}

/// "distance median 1.4 m, most 3.9 m": the first few, the rest is for programs.
std::string agreement_text(const control::Agreement& one) {
  constexpr int kShown = 4;
  std::string text;
  for (int i = 0; i < std::min(kShown, one.differences_size()); ++i) {
    const auto& difference = one.differences(i);
    const std::string unit = difference.unit().empty() ? "" : " " + difference.unit();
    text += fmt::format("{}{} median {:.3g}{}, max {:.3g}{}", text.empty() ? "" : "; ", difference.field(),
                        difference.median(), unit, difference.most(), unit);
  }
  const bool all_valid = one.old_valid() == one.old_messages() && one.next_valid() == one.next_messages();
  if (!text.empty() && all_valid) return text;
  return fmt::format("{}{}{} messages ({} valid) and {} ({} valid)", text, text.empty() ? "" : "; ", one.old_messages(),
                     one.old_valid(), one.next_messages(), one.next_valid());
}

std::string agreements_text(const control::Done& done) {
  std::string text;
  for (const auto& one : done.agreements()) {
    const std::string names =
        done.agreements_size() == 1 ? "" : fmt::format(", {} and {}", text_of(one.old()), text_of(one.next()));
    text +=
        fmt::format("{}{:g} s together{}: {}", text.empty() ? "" : "\n", done.watched_s(), names, agreement_text(one));
  }
  return text;
}

nlohmann::json agreement_facts(const control::Agreement& one) {
  nlohmann::json facts{{"old", text_of(one.old())},
                       {"next", text_of(one.next())},
                       {"old_messages", one.old_messages()},
                       {"next_messages", one.next_messages()},
                       {"old_valid", one.old_valid()},
                       {"next_valid", one.next_valid()},
                       {"differences", nlohmann::json::array()}};
  for (const auto& difference : one.differences()) {
    facts["differences"].push_back({{"field", difference.field()},
                                    {"unit", difference.unit()},
                                    {"median", difference.median()},
                                    {"max", difference.most()},
                                    {"compared", difference.compared()}});
  }
  return facts;
}

void tell_plan(Session& session, const control::Planned& planned) {
  nlohmann::json facts{{"steps", lines_of(planned.steps())}, {"reverse", lines_of(planned.reverse())}};
  facts["warnings"] = std::vector<std::string>(planned.warnings().begin(), planned.warnings().end());
  session.out.object(facts);
  if (planned.steps().empty()) return session.out.text("nothing to change");
  std::string text;
  for (const auto& line : lines_of(planned.steps())) text += line + "\n";
  text += planned.reverse().empty() ? "nothing would take this back" : "taken back by";
  for (const auto& line : lines_of(planned.reverse())) text += "\n  " + line;
  for (const auto& warning : planned.warnings()) text += "\n" + warning;
  session.out.text(text);
}

}  // namespace

std::string line_of(const control::Change& change) {
  switch (change.what_case()) {
    case control::Change::kLoad: return load_line(change.load());
    case control::Change::kUnload: return "unload " + typed_text(change.unload().instance());
    case control::Change::kWire: return wire_line(change.wire());
    case control::Change::kUnwire: return "unwire " + typed_port(change.unwire().client());
    case control::Change::kSet:
      return with_arguments("set " + typed_text(change.set().instance()), change.set().parameters());
    case control::Change::kState:
      return fmt::format("state {} {}", typed_text(change.state().instance()), typed_text(change.state().mode()));
    case control::Change::kReplace:
      return fmt::format(
          "swap {} for {}{}", typed_text(change.replace().old()), typed_text(change.replace().next()),
          change.replace().watch_ms() > 0 ? fmt::format(" watch {:g}ms", change.replace().watch_ms()) : "");
    case control::Change::kUpgrade:
      return fmt::format("upgrade {}{}", typed_text(change.upgrade().instance()),
                         change.upgrade().version().empty() ? "" : " to " + typed_text(change.upgrade().version()));
    case control::Change::WHAT_NOT_SET: break;
  }
  return "# a change that this console does not know";
}

void tell(Session& session, const control::Reply& reply, const std::string& otherwise, const std::string& place) {
  if (reply.has_planned()) return tell_plan(session, reply.planned());
  const control::Done& done = reply.done();
  std::string note = done.note().empty() ? otherwise : done.note();
  nlohmann::json facts = nlohmann::json::object();
  for (const auto& one : done.agreements()) facts["agreements"].push_back(agreement_facts(one));
  if (done.agreements_size() > 0) note = agreements_text(done) + "\n" + note;
  if (done.entry() != 0) facts["entry"] = done.entry();
  if (done.switched() > 0) {
    note += fmt::format("; switched {} wire{}, gap {:.3g} ms, lost {}", done.switched(),
                        done.switched() == 1 ? "" : "s", done.gap_ms(), done.lost());
    if (done.redirected() > 0) note += fmt::format(", redirected {}", done.redirected());
    facts.update({{"switched", done.switched()},
                  {"gap_ms", done.gap_ms()},
                  {"lost", done.lost()},
                  {"redirected", done.redirected()}});
  }
  session.out.done(note, facts);
  for (const auto& warning : done.warnings()) session.out.warning(place.empty() ? warning : place + ": " + warning);
}

void make(Session& session, const Line& line, control::Change change, const std::string& otherwise) {
  if (session.batch) {
    session.batch->changes.push_back(std::move(change));
    session.batch->lines.push_back(line);
    return;
  }
  control::Request request;
  *request.mutable_transact()->add_changes() = std::move(change);
  request.mutable_transact()->set_dry_run(session.planning);
  const std::string place = line.words.origin.empty() ? "" : place_text(line.words, line.verb.place);
  // A component may need its time, and what others change comes first: given up half way it would be made all the same.
  tell(session, session.host().call_waiting(std::move(request)), otherwise, place);
}

void make(Session& session, const Batch& batch, bool whole) {
  control::Request request;
  auto& transact = *request.mutable_transact();
  for (const auto& change : batch.changes) *transact.add_changes() = change;
  transact.set_whole(whole);
  transact.set_dry_run(session.planning);
  try {
    tell(session, session.host().call_waiting(std::move(request)), fmt::format("{} changes", batch.changes.size()));
  } catch (const RefusedChange& refused) {
    if (refused.change() == 0 || refused.change() > batch.lines.size()) throw;
    const Line& line = batch.lines[refused.change() - 1];
    throw LineError(line.words, line.verb.place, refused.text(), refused.code());
  }
}

}  // namespace fiona::console
