// load, unload, wire, unwire: what changes the composition.
#include <fmt/format.h>

#include "../catalogue.hpp"
#include "../changes.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

/// What the host is to load. What another machine's host is told it takes as it is.
std::string plugin_of(Session& session, const Line& line, const Word& word) {
  return session.host().remote() ? word.text : loadable(line.words, word.text);
}

}  // namespace

void load(Session& session, const Line& line) {
  control::Change change;
  control::Load& load = *change.mutable_load();
  load.set_plugin(plugin_of(session, line, line.positional[0]));
  if (const Word* name = line.clause("as")) load.set_instance(name->text);
  if (const Word* group = line.clause("in")) load.set_group(group->text);
  if (const Word* mode = line.clause("at")) load.set_mode(mode->text);
  for (const Word& right : line.clause_words("with")) load.add_rights(right.text);
  load.set_comment(line.words.comment);
  for (control::Argument& argument : line.control_arguments()) *load.add_parameters() = std::move(argument);
  const std::string name = load.instance().empty() ? load.plugin() : load.instance();
  make(session, line, std::move(change), fmt::format("loaded {}", name));
}

void unload(Session& session, const Line& line) {
  control::Change change;
  change.mutable_unload()->set_instance(line.positional[0].text);
  make(session, line, std::move(change), fmt::format("unloaded {}", line.positional[0].text));
}

void wire(Session& session, const Line& line) {
  control::Change change;
  control::Wire& wire = *change.mutable_wire();
  const Word& provider = *line.clause("to");
  *wire.mutable_client() = port_name(line.positional[0], line.words);
  *wire.mutable_provider() = port_name(provider, line.words);
  for (const Word& other : line.clause_words("else")) *wire.add_alternatives() = port_name(other, line.words);
  if (const Word* hold = line.argument("hold")) wire.set_hold_ms(duration_ms(*hold, line.words));
  if (const Word* every = line.clause("every")) wire.set_prescale(count_of(*every, line.words));
  make(session, line, std::move(change), fmt::format("wired {} to {}", line.positional[0].text, provider.text));
}

void unwire(Session& session, const Line& line) {
  control::Change change;
  *change.mutable_unwire()->mutable_client() = port_name(line.positional[0], line.words);
  make(session, line, std::move(change), fmt::format("unwired {}", line.positional[0].text));
}

}  // namespace fiona::console::verbs
