#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "../help_texts.hpp"
#include "../locations.hpp"
#include "../verb_table.hpp"
#include "verbs.hpp"

#ifndef FIONA_VERSION
#error "the build passes the project's version"
#endif

namespace fiona::console::verbs {
namespace {

void help_for(Session& session, const Verb& verb) {
  std::vector<std::string> forms;
  for (const Shape& shape : verb.forms) forms.push_back(shape.text());
  session.out.object({{"verb", verb.name},
                      {"forms", forms},
                      {"does", verb.does},
                      {"more", verb.more},
                      {"access", static_cast<int>(verb.access)}});
  std::string text = fmt::format("{}\n\n{}", fmt::join(forms, "\n"), verb.does);
  if (!verb.more.empty()) text += "\n" + verb.more;
  session.out.text(text + "\nneeds access level: " + access_text(verb.access));
}

void help_all(Session& session) {
  Table table({"verb", "does", "access"});
  for (const Verb& verb : verb_rows())
    table.add({verb.name, verb.does, {access_text(verb.access), static_cast<int>(verb.access)}});
  session.out.table(table, "");
  Table options({"option", "does"});
  for (const GlobalOption& option : global_options()) {
    options.add({option.slot.takes_value() ? fmt::format("{} {}", option.slot.name, option.slot.slot.placeholder())
                                           : option.slot.name,
                 option.does});
  }
  session.out.text("");
  session.out.table(options, "");
  session.out.text("\nMore: help VERB, help grammar, help patterns, help exit");
}

}  // namespace

void help(Session& session, const Line& line) {
  if (line.positional.empty()) return help_all(session);
  const Word& about = line.positional[0];
  if (const Verb* verb = find_verb(about.text)) return help_for(session, *verb);
  const auto& topics = help_topics();
  const auto topic =
      std::find_if(topics.begin(), topics.end(), [&about](const HelpTopic& one) { return one.name == about.text; });
  if (topic == topics.end()) {
    std::vector<std::string> known;
    for (const HelpTopic& one : topics) known.emplace_back(one.name);
    for (const Verb& verb : verb_rows()) known.push_back(verb.name);
    throw line.error(about,
                     {.what = fmt::format("there is no help on '{}'", about.text),
                      .next = "help",
                      .near = nearest_names(about.text, known)},
                     ErrorCode::NotFound);
  }
  session.out.object({{"help", about.text}, {"text", topic->text}});
  session.out.text(topic->text);
}

void version(Session& session, const Line&) {
  nlohmann::json object{{"console", FIONA_VERSION}};
  std::string text = "fiona " FIONA_VERSION;
  if (session.host_if_running() != nullptr) {
    const control::System system = session.snapshot();
    object["host"] = {{"name", system.host()}, {"version", system.version()}};
    text += fmt::format("\nhost {} {}", system.host(), system.version());
  }
  session.out.object(object);
  session.out.text(text);
}

}  // namespace fiona::console::verbs
