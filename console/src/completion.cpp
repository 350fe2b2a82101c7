#include "completion.hpp"

#include <algorithm>
#include <map>
#include <set>

#include "author/plugin_template.hpp"
#include "system_view.hpp"
#include "top_view.hpp"
#include "verb_table.hpp"

namespace fiona::console {
namespace {

struct Asked {
  std::string_view word;  ///< as far as it is typed
  const Line& line;       ///< what stands before it
  Names& names;
};
using Candidates = std::vector<std::string>;

Candidates instances(const Asked& asked) {
  const auto* system = asked.names.system();
  Candidates names = system == nullptr ? Candidates{} : instance_names(*system);
  if (asked.line.verb.text == "set" || asked.line.verb.text == "get") names.emplace_back("host");
  return names;
}

const control::PortStatus* named_port(const control::System& system, std::string_view name) {
  const std::size_t dot = std::min(name.find('.'), name.size());
  const auto* instance = find_instance(system, name.substr(0, dot));
  return instance == nullptr || dot == name.size() ? nullptr : find_port(*instance, name.substr(dot + 1));
}

/// Of what a port says, or a probe that is an object.
Candidates fields_of(std::string_view name, const Asked& asked) {
  const auto* system = asked.names.system();
  if (system == nullptr) return {};
  if (const auto* port = named_port(*system, name)) return asked.names.fields(port->service());
  const std::size_t dot = std::min(name.find('.'), name.size());
  const auto* instance = find_instance(*system, name.substr(0, dot));
  if (instance == nullptr || dot == name.size()) return {};
  for (const ProbeInfo& probe : probes_of(*instance)) {
    if (probe.name == name.substr(dot + 1)) return asked.names.fields(probe.type);
  }
  return {};
}

Candidates fields(const Asked& asked) {
  return asked.line.positional.empty() ? Candidates{} : fields_of(asked.line.positional[0].text, asked);
}

/// Those that the component declares and those of the hull; of its ports and tasks, once one of them is named.
Candidates probes(const Asked& asked) {
  Candidates found;
  const auto* system = asked.names.system();
  const bool in_detail = std::count(asked.word.begin(), asked.word.end(), '.') > 1;
  for (int i = 0; system != nullptr && i < system->instances_size(); ++i) {
    for (const ProbeInfo& probe : probes_of(system->instances(i))) {
      if (in_detail || probe.name.find('.') == std::string::npos)
        found.push_back(system->instances(i).name() + "." + probe.name);
    }
  }
  return found;
}

Candidates ports(const Asked& asked) {
  Candidates found;
  const auto* system = asked.names.system();
  if (system == nullptr) return found;
  // `wire` and `unwire` begin with a required port; after `to` stands one that provides what it requires.
  const bool wiring = asked.line.verb.text == "wire" || asked.line.verb.text == "unwire";
  const auto wanted = asked.line.positional.empty() ? fiona::REQUIRES : fiona::PROVIDES;
  const auto* client = asked.line.positional.empty() ? nullptr : named_port(*system, asked.line.positional[0].text);
  for (const auto& instance : system->instances()) {
    for (const auto& port : instance.ports()) {
      const bool fits = port.direction() == wanted && (client == nullptr || port.service() == client->service());
      if (!wiring || fits) found.push_back(instance.name() + "." + port.name());
    }
  }
  if (wiring) return found;
  const Candidates more = probes(asked);
  found.insert(found.end(), more.begin(), more.end());
  return found;
}

/// A port, and once one is typed its fields; probes among both.
Candidates ports_and_fields(const Asked& asked) {
  Candidates found = ports(asked);
  const std::size_t first = asked.word.find('.');
  const std::size_t second = first == std::string_view::npos ? first : asked.word.find('.', first + 1);
  if (second == std::string_view::npos) return found;
  const std::string port(asked.word.substr(0, second));
  for (const std::string& field : fields_of(port, asked)) found.push_back(port + "." + field);
  return found;
}

/// What `call` and `send` can use: by pattern, and triggers.
Candidates callees(const Asked& asked) {
  Candidates found;
  const auto* system = asked.names.system();
  const bool send = asked.line.verb.text == "send";
  for (int i = 0; system != nullptr && i < system->instances_size(); ++i) {
    const auto& instance = system->instances(i);
    for (const auto& port : instance.ports()) {
      if (port.pattern() == (send ? fiona::SEND : fiona::QUERY)) found.push_back(instance.name() + "." + port.name());
    }
    for (const auto& trigger : instance.triggers()) {
      if (!send) found.push_back(instance.name() + "." + trigger.name());
    }
  }
  return found;
}

const control::InstanceStatus* named_instance(const Asked& asked) {
  const auto* system = asked.names.system();
  if (system == nullptr || asked.line.positional.empty()) return nullptr;
  return find_instance(*system, asked.line.positional[0].text);
}

Candidates modes(const Asked& asked) {
  const auto* instance = named_instance(asked);
  Candidates found{"neutral", "deactivated"};
  if (instance != nullptr)
    found.insert(found.end(), instance->modes().begin(), instance->modes().end());
  else
    found.emplace_back("active");
  return found;
}

Candidates parameters(const Asked& asked) {
  Candidates found;
  if (asked.line.verb.text == "load") {
    if (!asked.line.positional.empty()) found = asked.names.parameters(asked.line.positional[0].text);
  } else if (const auto* instance = named_instance(asked)) {
    for (const auto& parameter : instance->parameters()) found.push_back(parameter.name());
  } else if (!asked.line.positional.empty() && asked.line.positional[0].text == "host") {
    found = {"clock", "deliveries", "speed", "start"};
  }
  return found;
}

/// Values where the range names them: "up|down", and true or false.
Candidates parameter_values(const Asked& asked, std::string_view name) {
  if (!asked.line.positional.empty() && asked.line.positional[0].text == "host" && name == "clock")
    return {"system", "virtual"};
  Candidates found;
  const auto* instance = named_instance(asked);
  for (int i = 0; instance != nullptr && i < instance->parameters_size(); ++i) {
    const auto& parameter = instance->parameters(i);
    if (parameter.name() != name) continue;
    if (parameter.type() == "bool") return {"false", "true"};
    if (parameter.range().find('|') == std::string::npos) continue;
    for (std::string_view rest = parameter.range(); !rest.empty();) {
      const std::size_t end = std::min(rest.find('|'), rest.size());
      found.emplace_back(rest.substr(0, end));
      rest.remove_prefix(std::min(end + 1, rest.size()));
    }
  }
  return found;
}

Candidates groups(const Asked& asked) {
  Candidates found{"main"};
  const auto* system = asked.names.system();
  for (int i = 0; system != nullptr && i < system->groups_size(); ++i) found.push_back(system->groups(i).name());
  return found;
}

Candidates things(const Asked& asked) {
  Candidates found = instances(asked);
  for (const auto& part : {ports(asked), asked.names.plugins()}) found.insert(found.end(), part.begin(), part.end());
  const auto* system = asked.names.system();
  for (int i = 0; system != nullptr && i < system->instances_size(); ++i) {
    for (const auto& port : system->instances(i).ports()) found.push_back(short_name(port.service()));
  }
  return found;
}

Candidates verb_names(const Asked&) {
  Candidates found;
  for (const Verb& verb : verb_rows()) found.push_back(verb.name);
  return found;
}

/// A new plugin has types for those of the platform; what is searched for may be anybody's.
Candidates services(const Asked& asked) {
  if (asked.line.verb.text == "market") return asked.names.services();
  Candidates found;
  for (const auto* service : platform_services()) found.push_back(service->name());
  return found;
}

Candidates rights(const Asked&) { return {"master", "network", "confined", "unconfined"}; }
Candidates conditions(const Asked&) { return {"above", "below", "is", "changes", "older"}; }
Candidates operators(const Asked&) { return {"==", "!=", "<", "<=", ">", ">="}; }

using Source = Candidates (*)(const Asked&);
const std::map<std::string, Source, std::less<>>& sources() {
  static const std::map<std::string, Source, std::less<>> kSources{
      {"INSTANCE", instances},
      {"INSTANCE.PORT", ports},
      {"INSTANCE.PORT.FIELD", ports_and_fields},
      {"FIELD", fields},
      {"INSTANCE.NAME", callees},
      {"MODE", modes},
      {"PARAM", parameters},
      {"GROUP", groups},
      {"RIGHT", rights},
      {"SERVICE", services},
      {"THING", things},
      {"VERB", verb_names},
      {"LINE", verb_names},
      {"OP", operators},
      {"CONDITION", conditions},
      {"COLUMN",
       [](const Asked&) {
         return Candidates{TopView::kOrders.begin(), TopView::kOrders.end()};
       }},
      {"PLUGIN", [](const Asked& asked) { return asked.names.plugins(); }},
      {"PACKAGE", [](const Asked& asked) { return asked.names.packages(); }},
      {"FILE", [](const Asked& asked) { return asked.names.files(asked.word); }},
      {"LIBRARY", [](const Asked& asked) { return asked.names.files(asked.word); }},
      {"DIR", [](const Asked& asked) { return asked.names.files(asked.word); }}};
  return kSources;
}

void add_slot(Candidates& found, const Slot& slot, const Asked& asked) {
  for (const std::string& literal : slot.literals()) found.push_back(literal);
  const auto source = sources().find(slot.placeholder());
  if (source == sources().end()) return;
  const Candidates more = source->second(asked);
  found.insert(found.end(), more.begin(), more.end());
}

/// What may follow `name=` or `--option=`.
void add_values(Candidates& found, const Shape& shape, const Asked& asked) {
  const std::size_t begin = asked.word.find('=') + 1;
  const std::string_view name = asked.word.substr(0, begin - 1);
  Candidates values;
  const Asked value{asked.word.substr(begin), asked.line, asked.names};
  if (const ArgumentSlot* argument = shape.find_argument(name)) {
    add_slot(values, argument->slot, value);
  } else if (const OptionSlot* option = shape.find_option(name)) {
    add_slot(values, option->slot, value);
  } else {
    values = parameter_values(asked, name);
  }
  for (const std::string& one : values) found.push_back(std::string(asked.word.substr(0, begin)) + one);
}

/// The words before the one that is typed, read as far as the shape goes, without complaint.
Line partial_line(const WordLine& words, const Shape& shape, const Slot*& pending) {
  Line line;
  line.words = words;
  line.verb = words.items.front().word;
  pending = nullptr;
  for (std::size_t i = 1; i < words.items.size(); ++i) {
    const WordLine::Item& item = words.items[i];
    if (item.name) {
      line.arguments.push_back({*item.name, item.word});
    } else if (pending != nullptr) {
      pending = nullptr;
    } else if (const Clause* clause = item.word.kind == WordKind::Plain ? shape.find_clause(item.word.text) : nullptr) {
      line.clauses.emplace(clause->keyword, std::vector{item.word});
      pending = &clause->slot;
    } else if (const OptionSlot* option = shape.find_option(item.word.text)) {
      line.options.emplace(option->name, TypedArgument{});
      if (option->takes_value()) pending = &option->slot;
    } else {
      line.positional.push_back(item.word);
    }
  }
  return line;
}

void add_by_shape(Candidates& found, const WordLine& words, const Shape& shape, std::string_view word, Names& names) {
  const Slot* pending = nullptr;
  const Line line = partial_line(words, shape, pending);
  const Asked asked{word, line, names};
  if (pending != nullptr) return add_slot(found, *pending, asked);
  if (word.find('=') != std::string_view::npos) return add_values(found, shape, asked);
  const auto& slots = shape.positional();
  const bool first_matches = line.positional.empty() || slots.empty() || slots.front().accepts(line.positional.front());
  if (!first_matches) return;
  const bool more = !slots.empty() && slots.back().repeated;
  if (line.positional.size() < slots.size() || more)
    add_slot(found, slots[std::min(line.positional.size(), slots.size() - 1)], asked);
  if (line.positional.size() < slots.size() && slots[line.positional.size()].required) return;
  for (const Clause& clause : shape.clauses()) {
    if (!line.clauses.contains(clause.keyword) || clause.slot.repeated) found.push_back(clause.keyword);
  }
  for (const ArgumentSlot& argument : shape.arguments()) {
    if (line.argument(argument.name) == nullptr) found.push_back(argument.name + "=");
  }
  if (shape.takes_arguments() && shape.arguments().empty()) {
    for (const std::string& name : parameters(asked)) found.push_back(name + "=");
  }
  if (!word.starts_with('-')) return;
  for (const OptionSlot& option : shape.options()) found.push_back(option.name);
  for (const GlobalOption& option : global_options()) found.push_back(option.slot.name);
}

}  // namespace

std::optional<std::map<std::string, std::string>> take_global_options(WordLine& words) {
  std::map<std::string, std::string> options;
  while (!words.empty() && !words.items.front().name && words.items.front().word.text.starts_with('-')) {
    const std::string name = words.items.front().word.text;
    words.items.erase(words.items.begin());
    const auto option = std::find_if(global_options().begin(), global_options().end(),
                                     [&name](const GlobalOption& one) { return one.slot.name == name; });
    if (option == global_options().end() || !option->slot.takes_value()) continue;
    if (words.empty()) return std::nullopt;
    options[name] = words.items.front().word.text;
    words.items.erase(words.items.begin());
  }
  return options;
}

std::vector<std::string> completed_placeholders() {
  std::vector<std::string> names;
  for (const auto& [name, source] : sources()) names.push_back(name);
  return names;
}

Completion complete(std::string_view typed, Names& names) {
  Completion completion;
  const std::size_t blank = typed.find_last_of(" \t");
  completion.start = blank == std::string_view::npos ? 0 : blank + 1;
  const std::string_view word = typed.substr(completion.start);
  WordLine before;
  try {
    before = split_line(typed.substr(0, completion.start));
  } catch (const Error&) {
    return completion;  // inside a quote: nothing is known
  }
  Candidates found;
  if (!take_global_options(before)) return completion;
  if (const Verb* outer = before.empty() ? nullptr : find_verb(before.items.front().word.text);
      outer && outer->takes_line) {
    before.items.erase(before.items.begin());
  }
  if (before.empty()) {
    for (const Verb& verb : verb_rows()) found.push_back(verb.name);
    if (word.starts_with('-'))
      for (const GlobalOption& option : global_options()) found.push_back(option.slot.name);
  } else if (const Verb* verb = find_verb(before.items.front().word.text)) {
    for (const Shape& shape : verb->forms) add_by_shape(found, before, shape, word, names);
  }
  const std::set<std::string> sorted(found.begin(), found.end());
  for (const std::string& candidate : sorted) {
    // What needs quotes is left out: a half-typed bare word cannot grow into a quoted one.
    const bool bare = candidate.find('=') != std::string::npos || quoted_word(candidate) == candidate;
    if (bare && candidate.starts_with(word)) completion.candidates.push_back(candidate);
  }
  return completion;
}

}  // namespace fiona::console
