#include "manual.hpp"

#include <array>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "help_texts.hpp"
#include "inert.hpp"
#include "system_view.hpp"
#include "verb_table.hpp"

namespace fiona::console {
namespace {

/// Text that stands for itself: roff's escapes, and the control characters of a line's begin.
std::string roff(std::string_view text) {
  std::string escaped;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (const Character wide = decode(text.substr(i)); wide.bytes > 1) {
      escaped += fmt::format("\\[u{:04X}]", static_cast<unsigned>(wide.code));
      i += wide.bytes - 1;
      continue;
    }
    const bool begins = i == 0 || text[i - 1] == '\n';
    if (begins && (c == '.' || c == '\'')) escaped += "\\&";
    switch (c) {
      case '\\': escaped += "\\e"; break;
      case '-': escaped += "\\-"; break;
      case '\'': escaped += "\\(aq"; break;
      case '`': escaped += "\\(ga"; break;
      case '^': escaped += "\\(ha"; break;
      case '~': escaped += "\\(ti"; break;
      default: escaped += c;
    }
  }
  return escaped;
}

/// Each line of the text a line of the page.
std::string roff_lines(std::string_view text) {
  std::string out;
  for (const std::string& line : split_lines(text)) out += (out.empty() ? "" : ".br\n") + roff(line) + "\n";
  return out;
}

std::string title(const char* name, int section, const std::string& version) {
  return fmt::format(".\\\" Made from the table of verbs.\n.TH {} {} \"\" \"fiona {}\" \"FIONA\"\n", name, section,
                     version);
}

std::string section(const char* heading, const std::string& body) { return fmt::format(".SH {}\n{}", heading, body); }

std::string tagged(const std::string& tag, const std::string& body) { return fmt::format(".TP\n.B {}\n{}", tag, body); }

/// `in_files`: without what only a shell may say.
std::string verbs_text(bool in_files) {
  std::string text;
  for (const Verb& verb : verb_rows()) {
    if (in_files && verb.name == "run") continue;
    std::string forms;
    for (const Shape& shape : verb.forms)
      forms += fmt::format("{}{}", forms.empty() ? "" : "\n.TQ\n.B ", roff(shape.text()));
    std::string body = roff(verb.does) + ".\n";
    if (!verb.more.empty()) body += ".br\n" + roff_lines(verb.more);
    text += tagged(forms, body);
  }
  return text;
}

std::string options_text() {
  std::string text;
  for (const GlobalOption& option : global_options()) {
    const std::string value = option.slot.takes_value() ? " " + option.slot.slot.placeholder() : "";
    text += tagged(roff(option.slot.name + value), roff(option.does) + "\n");
  }
  return text;
}

std::string exit_codes_text() {
  std::string text;
  for (const std::string& line : split_lines(exit_code_text())) {
    const std::size_t blank = line.find(' ');
    text += tagged(line.substr(0, blank), roff(line.substr(line.find_first_not_of(' ', blank))) + "\n");
  }
  return text;
}

std::string environment_text() {
  constexpr std::array<std::pair<const char*, const char*>, 7> kVariables{{
      {"FIONA_STORE", "where packages are installed"},
      {"FIONA_MARKET", "the marketplace, a directory or an address, unless --from names one"},
      {"FIONA_KEYS", "where the keys of hosts and consoles are"},
      {"XDG_RUNTIME_DIR", "below it, fiona/NAME.sock of each host"},
      {"XDG_STATE_HOME", "below it, fiona/history of the prompt and fiona/NAME.journal of each host"},
      {"XDG_DATA_HOME", "below it, fiona/store, unless FIONA_STORE says otherwise"},
      {"XDG_CONFIG_HOME", "below it, fiona with the keys of hosts, unless FIONA_KEYS says otherwise"},
  }};
  std::string text;
  for (const auto& [name, meaning] : kVariables) text += tagged(name, roff(meaning) + "\n");
  return text;
}

}  // namespace

std::string command_manual(const std::string& version) {
  return title("FIONA", 1, version) +
         section("NAME", "fiona \\- compose, rewire and watch systems of localisation and navigation components\n") +
         section("SYNOPSIS",
                 ".B fiona\n[\\fIOPTION\\fR ...]\n[\\fILINE\\fR]\n.br\n.B fiona run\n[\\fIFILE\\fR ...]\n") +
         section("DESCRIPTION", roff("Speaks to a running host, or starts one (run). Without a line, a prompt where "
                                     "standard input is a terminal; "
                                     "otherwise lines are read from there. One argument is a line, several are words "
                                     "that are not split again.") +
                                    "\n.PP\n" + roff_lines(grammar_text())) +
         section("OPTIONS", options_text()) + section("VERBS", verbs_text(false)) +
         section("EXIT STATUS", exit_codes_text()) + section("ENVIRONMENT", environment_text()) +
         section("SEE ALSO", ".BR fiona\\-system (5)\n");
}

std::string system_file_manual(const std::string& version) {
  return title("FIONA-SYSTEM", 5, version) +
         section("NAME", "fiona\\-system \\- a system of components as a script (*.fiona)\n") +
         section("DESCRIPTION", roff("A system file has the lines that one would type at the prompt; fiona save writes "
                                     "one, fiona run starts it, "
                                     "fiona check reads it without starting anything, fiona apply makes a running "
                                     "system equal to it. All lines "
                                     "are read before the first is run. It stops at the first line that fails.") +
                                    "\n.PP\n" + roff_lines(grammar_text())) +
         section("LINES", verbs_text(true)) +
         section("EXAMPLE", ".nf\n" +
                                roff("load building-simulator as phone seed=7\nload step-heading as steps\n"
                                     "wire steps.imu to phone.imu\n") +
                                ".fi\n") +
         section("SEE ALSO", ".BR fiona (1)\n");
}

}  // namespace fiona::console
