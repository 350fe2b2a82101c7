#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "../locations.hpp"
#include "../verb_table.hpp"
#include "verbs.hpp"

#ifndef FIONA_VERSION
#error "the build passes the project's version"
#endif

namespace fiona::console::verbs {
namespace {

constexpr std::string_view kExitCodes =
    "0  done\n1  failed\n2  not understood\n3  something named does not exist\n"
    "4  ports do not fit, or white spots remain with --strict\n5  a signature or hash does not match\n"
    "6  versions or requirements cannot be met together\n7  nobody answered in time\n8  not allowed\n"
    "9  a component failed\n130  interrupted";

constexpr std::string_view kGrammar =
    "One command a line; the same at the prompt, in a system file and in the shell.\n"
    "# begins a comment; a trailing \\ goes on with the next line.\n"
    "\"x y\" is one word; inside: \\\" \\\\ \\n \\t \\u{e9}\n"
    "name=value: a word, a quoted text, a number with an optional unit (200ms, 1.5m, 30deg),\n"
    "true or false, a list [a, b], or protobuf text {x: 1}.\n"
    "Keywords: as in to else for with at every; as a name, a keyword is quoted.\n"
    "In the shell one argument is a line (fiona 'set a name=\"x y\"'), several are ready words (fiona set a rate=5).";

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
  session.out.text("\nMore: help VERB, help grammar, help exit");
}

}  // namespace

void help(Session& session, const Line& line) {
  if (line.positional.empty()) return help_all(session);
  const Word& about = line.positional[0];
  if (const Verb* verb = find_verb(about.text)) return help_for(session, *verb);
  const std::string_view text = about.text == "exit" ? kExitCodes : about.text == "grammar" ? kGrammar : "";
  if (text.empty()) {
    std::vector<std::string> known{"exit", "grammar"};
    for (const Verb& verb : verb_rows()) known.push_back(verb.name);
    throw line.error(about,
                     {.what = fmt::format("there is no help on '{}'", about.text),
                      .next = "help",
                      .near = nearest_names(about.text, known)},
                     ErrorCode::NotFound);
  }
  session.out.object({{"help", about.text}, {"text", text}});
  session.out.text(text);
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
