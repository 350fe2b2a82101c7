#include "help_texts.hpp"

namespace fiona::console {
namespace {

constexpr std::string_view kExitCodes =
    "0  done\n1  failed\n2  not understood\n3  something named does not exist\n"
    "4  ports do not fit, or white spots remain with --strict\n5  a signature or hash does not match\n"
    "6  versions or requirements cannot be met together\n7  nobody answered in time\n8  not allowed\n"
    "9  a component failed\n130  interrupted\n"
    "141  whoever read the output has gone";

constexpr std::string_view kGrammar =
    "One command a line; the same at the prompt, in a system file and in the shell.\n"
    "# begins a comment; a trailing \\ goes on with the next line.\n"
    "\"x y\" is one word; inside: \\\" \\\\ \\n \\t \\u{e9}\n"
    "name=value: a word, a quoted text, a number with an optional unit (200ms, 1.5m, 30deg),\n"
    "true or false, a list [a, b], or protobuf text {x: 1}.\n"
    "Keywords: as in to else for with at every when; as a name, a keyword is quoted.\n"
    "In the shell one argument is a line (fiona 'set a name=\"x y\"'), several are ready words (fiona set a rate=5).";

/// The nine ways in which components communicate, and the verb that goes with each.
constexpr std::string_view kPatterns =
    "send            one way, many clients to one provider; queued, or acknowledged by it    send PORT {...}\n"
    "query           a question and its answer, or why there is none, within a deadline      call PORT {...}\n"
    "push newest     the newest value to all who are wired, as it changes                    watch PORT\n"
    "push timed      the same at a fixed cycle; a client may take each N-th                  watch PORT\n"
    "event           fires when a condition holds that each client gives with its own state  watch PORT\n"
    "parameter       checked, all or none, as a snapshot for the component                   set, get\n"
    "state           modes with activities; a change waits until they are free               state\n"
    "dynamic wiring  clients change providers while they run, without a loss                 wire, unwire, swap\n"
    "monitoring      probes of a component, and of what its hull counts                      watch PROBE when ...\n"
    "Of a call that waits the outcome is one of: ok, no_data, timeout, cancelled, disconnected, unwired, not_active,\n"
    "wrong_id, rejected with a reason.";

}  // namespace

std::string_view exit_code_text() { return kExitCodes; }
std::string_view grammar_text() { return kGrammar; }

const std::vector<HelpTopic>& help_topics() {
  static const std::vector<HelpTopic> kTopics{{"exit", kExitCodes}, {"grammar", kGrammar}, {"patterns", kPatterns}};
  return kTopics;
}

}  // namespace fiona::console
