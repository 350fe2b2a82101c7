// The `fiona` command: everything a person types.
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <unistd.h>

#include "command_line.hpp"
#include "fiona/tool.hpp"
#include "line_editor.hpp"
#include "prompt.hpp"
#include "script.hpp"
#include "session.hpp"
#include "verb_table.hpp"
#include "watch_list.hpp"

namespace {

using namespace fiona::console;

constexpr int kInterrupted = 130;
constexpr int kReaderGone = 141;

/// Lines from a pipe or a file: a script without a name. What watches for a time is waited for.
void run_standard_input(Session& session) {
  std::string text;
  if (!session.reactor.read_all(STDIN_FILENO, kLongestScript + 1, text))
    throw fiona::Error(fiona::ErrorCode::Failed,
                       {.what = fmt::format("standard input cannot be read: {}", std::strerror(errno)),
                        .next = "lines come from a pipe or a file: fiona < FILE"});
  std::vector<Line> lines;
  for (const WordLine& words : split_script(text, "stdin")) lines.push_back(read_line(words));
  run_script(session, lines);
  if (!session.finished) session.watches().wait(WatchList::Which::Timed);
}

/// At a terminal; nobody answers a question that a pipe or a script asks.
std::optional<bool> ask(Reactor& reactor, const std::string& question) {
  if (::isatty(STDIN_FILENO) == 0 || ::isatty(STDOUT_FILENO) == 0) return std::nullopt;
  LineEditor editor(reactor, {}, [](std::string_view) { return Completion{}; });
  const auto answer = editor.read(question, [] { return false; });
  return answer && (answer->starts_with('y') || answer->starts_with('Y'));
}

/// Other users of the machine see what a program was started with: from now on without the secrets in it.
void hide_secrets(char** words, const SecretNames& secrets) {
  for (bool hidden = false; *words != nullptr; ++words) {
    const std::size_t size = std::string_view(*words).size();
    const std::size_t begin = hidden ? 0 : secrets.begin_in(*words);
    hidden = begin != std::string_view::npos;
    if (hidden) std::fill(*words + begin, *words + size, '*');
  }
}

int serve(Reactor& reactor, Output& out, const std::vector<std::string>& arguments) {
  CommandLine command = read_command_line(arguments);
  out.manner = command.manner;
  if (command.help) command.line = split_line("help");
  if (command.version) command.line = split_line("version");
  reactor.take_signals();
  Session session(reactor, out, command.options);
  session.ask = [&reactor](const std::string& question) { return ask(reactor, question); };
  if (command.line) {
    if (!command.line->empty()) session.run(*command.line);
  } else if (::isatty(STDIN_FILENO) != 0) {
    run_prompt(session, {});
  } else {
    run_standard_input(session);
  }
  // `quit 3` ends the host with 3; the command that said so has succeeded unless it is the run itself.
  const bool is_run = command.line && !command.line->empty() && command.line->items.front().word.text == "run";
  return is_run ? session.finished.value_or(0) : 0;
}

}  // namespace

int main(int argc, char** argv) {
  fiona::open_standard_streams();
  Reactor reactor;
  Output out(Output::standard_sink(reactor));
  out.columns = Output::terminal_columns;
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  hide_secrets(argv, out.secrets);
  try {
    try {
      return serve(reactor, out, arguments);
    } catch (const Interrupted& interrupted) {
      if (interrupted.goes_on()) out.remark(interrupted.what());
      return kInterrupted;
    } catch (const fiona::Error& error) {
      out.error(error);
      return static_cast<int>(error.code());
    }
  } catch (const Interrupted&) {  // also while an error waits to be read
    return kInterrupted;
  } catch (const Terminated&) {
    return kInterrupted;
  } catch (const ReaderGone&) {
    return kReaderGone;
  } catch (const std::exception& error) {
    const std::string text = fmt::format("error: {}\n", error.what());
    static_cast<void>(::write(STDERR_FILENO, text.data(), text.size()));
    return static_cast<int>(fiona::ErrorCode::Failed);
  }
}
