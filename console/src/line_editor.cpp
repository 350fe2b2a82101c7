#include "line_editor.hpp"

#include <algorithm>
#include <clocale>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include <editline/readline.h>
#include <unistd.h>

#include "inert.hpp"

namespace fiona::console {
namespace {

constexpr int kMostHistory = 1000;

std::size_t terminal_columns() {
  const std::size_t known = Output::terminal_columns();
  return known > 0 ? known : 80;
}

/// As the library wants matches: the common beginning first, all from malloc, a null at the end.
char** match_array(const std::vector<std::string>& candidates) {
  std::string common = candidates.front();
  for (const std::string& candidate : candidates) {
    const auto [end, other] = std::mismatch(common.begin(), common.end(), candidate.begin(), candidate.end());
    common.erase(end, common.end());
  }
  auto** matches = static_cast<char**>(std::calloc(candidates.size() + 2, sizeof(char*)));
  matches[0] = ::strdup(common.c_str());
  for (std::size_t i = 0; i < candidates.size() && candidates.size() > 1; ++i)
    matches[i + 1] = ::strdup(candidates[i].c_str());
  return matches;
}

}  // namespace

/// The library calls plain functions, so they need to find the one editor.
LineEditor*& LineEditor::current() {
  static LineEditor* editor = nullptr;
  return editor;
}

LineEditor::LineEditor(Reactor& reactor, std::filesystem::path history, Completer completer)
    : reactor_(reactor), history_(std::move(history)), completer_(std::move(completer)) {
  current() = this;
  std::setlocale(LC_CTYPE, "");
  rl_readline_name = "fiona";
  rl_initialize();
  rl_basic_word_break_characters = " \t";
  rl_completer_word_break_characters = const_cast<char*>(rl_basic_word_break_characters);  // the library's type
  rl_attempted_completion_function = &LineEditor::on_complete;
  using_history();
  stifle_history(kMostHistory);
  if (history_.empty()) return;
  std::error_code problem;
  std::filesystem::create_directories(history_.parent_path(), problem);
  read_history(history_.c_str());
}

LineEditor::~LineEditor() {
  if (editing_) end_editing();
  current() = nullptr;
}

void LineEditor::remember(const std::string& line) {
  const bool blank = line.find_first_not_of(" \t\n") == std::string::npos;
  if (blank || line == last_remembered_) return;
  last_remembered_ = line;
  add_history(line.c_str());
  if (!history_.empty()) write_history(history_.c_str());
}

void LineEditor::begin_editing() {
  done_ = false;
  line_.reset();
  editing_ = true;
  rl_callback_handler_install(prompt_.c_str(), &LineEditor::on_line);
  reactor_.add_terminal([this] { read_character(); });
}

/// No exception passes through the editor's library.
void LineEditor::read_character() {
  rl_callback_read_char();
  if (terminated_) throw Terminated();
}

void LineEditor::end_editing() {
  editing_ = false;
  reactor_.remove(STDIN_FILENO);
  rl_callback_handler_remove();
}

std::optional<std::string> LineEditor::read(const std::string& prompt, const std::function<bool()>& ended) {
  prompt_ = prompt;
  begin_editing();
  try {
    reactor_.run_until([this, &ended] { return done_ || ended(); });
  } catch (...) {
    end_editing();
    std::fputs("\n", stdout);
    std::fflush(stdout);
    throw;
  }
  const bool unfinished = !done_;
  end_editing();
  if (unfinished || !line_) {
    std::fputs("\n", stdout);
    std::fflush(stdout);
  }
  return line_;
}

void LineEditor::on_line(char* line) {
  LineEditor& editor = *current();
  editor.done_ = true;
  if (line != nullptr) editor.line_ = line;
  std::free(line);
}

char** LineEditor::on_complete(const char*, int start, int end) {
  LineEditor& editor = *current();
  rl_attempted_completion_over = 1;
  // The completer may wait for the host, and a key must not be read inside of reading a key.
  editor.reactor_.remove(STDIN_FILENO);
  Completion completion;
  try {
    completion = editor.completer_(std::string_view(rl_line_buffer, static_cast<std::size_t>(end)));
  } catch (const Terminated&) {
    editor.terminated_ = true;
  } catch (const std::exception&) {
    completion.candidates.clear();  // nothing to offer; the key does nothing
  }
  editor.reactor_.add_terminal([&editor] { editor.read_character(); });
  if (completion.candidates.empty() || completion.start != static_cast<std::size_t>(start)) return nullptr;
  const std::string& only = completion.candidates.front();
  const bool goes_on = completion.candidates.size() > 1 || only.ends_with('=') || only.ends_with('/');
  rl_completion_append_character = goes_on ? '\0' : ' ';
  return match_array(completion.candidates);
}

std::size_t LineEditor::cursor_row() const {
  const std::string_view typed(rl_line_buffer == nullptr ? "" : rl_line_buffer);
  const std::size_t before = std::min<std::size_t>(static_cast<std::size_t>(std::max(rl_point, 0)), typed.size());
  return (display_width(prompt_) + display_width(typed.substr(0, before))) / terminal_columns();
}

bool LineEditor::has_text() const { return editing_ && rl_end > 0; }

void LineEditor::print(Stream stream, std::string_view lines) {
  std::FILE* file = stream == Stream::Out ? stdout : stderr;
  const bool above = editing_ && !done_;
  if (above) {
    // To the first row of what is typed, then everything from there on away.
    std::fputs("\r", stdout);
    for (std::size_t row = cursor_row(); row > 0; --row) std::fputs("\033[A", stdout);
    std::fputs("\033[J", stdout);
    std::fflush(stdout);
  }
  std::fwrite(lines.data(), 1, lines.size(), file);
  std::fflush(file);
  if (above) rl_forced_update_display();
}

}  // namespace fiona::console
