// load, unload, wire, unwire: what changes the composition.
#include <fmt/format.h>

#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

void call_and_tell(Session& session, control::Request request, const std::string& otherwise) {
  const control::Reply reply = session.call(std::move(request));
  session.out.done(reply.done().note().empty() ? otherwise : reply.done().note());
}

}  // namespace

void load(Session& session, const Line& line) {
  control::Request request;
  control::Load& load = *request.mutable_load();
  load.set_plugin(line.positional[0].text);
  if (const Word* name = line.clause("as")) load.set_instance(name->text);
  if (const Word* group = line.clause("in")) load.set_group(group->text);
  if (const Word* mode = line.clause("at")) load.set_mode(mode->text);
  for (control::Argument& argument : line.control_arguments()) *load.add_parameters() = std::move(argument);
  const std::string name = load.instance().empty() ? load.plugin() : load.instance();
  call_and_tell(session, std::move(request), fmt::format("loaded {}", name));
}

void unload(Session& session, const Line& line) {
  control::Request request;
  request.mutable_unload()->set_instance(line.positional[0].text);
  call_and_tell(session, std::move(request), fmt::format("unloaded {}", line.positional[0].text));
}

void wire(Session& session, const Line& line) {
  control::Request request;
  control::Wire& wire = *request.mutable_wire();
  const Word& provider = *line.clause("to");
  *wire.mutable_client() = port_name(line.positional[0], line.words);
  *wire.mutable_provider() = port_name(provider, line.words);
  if (const Word* every = line.clause("every")) wire.set_prescale(count_of(*every, line.words));
  call_and_tell(session, std::move(request), fmt::format("wired {} to {}", line.positional[0].text, provider.text));
}

void unwire(Session& session, const Line& line) {
  control::Request request;
  *request.mutable_unwire()->mutable_client() = port_name(line.positional[0], line.words);
  call_and_tell(session, std::move(request), fmt::format("unwired {}", line.positional[0].text));
}

}  // namespace fiona::console::verbs
