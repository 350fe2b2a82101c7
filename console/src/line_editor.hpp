#pragma once

#include <wchar.h>

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "completion.hpp"
#include "output.hpp"
#include "reactor.hpp"

struct editline;
struct history;

namespace fiona::console {

/// The line that a person types in a terminal: libedit, served by the reactor. Not behind its readline calls, which
/// lose the buffer of a long line that is not ASCII.
class LineEditor {
 public:
  /// Called with what is typed up to the cursor.
  using Completer = std::function<Completion(std::string_view)>;

  /// What is left of a terminal's lines in the library.
  struct End {
    void operator()(::editline* editor) const;
    void operator()(struct ::history* lines) const;
  };
  using Remembered = std::unique_ptr<struct ::history, End>;

  LineEditor(Reactor& reactor, std::filesystem::path history_file, Completer completer);
  LineEditor(const LineEditor&) = delete;
  LineEditor& operator=(const LineEditor&) = delete;
  ~LineEditor();

  /// Shows the prompt and waits for a line; nothing at Ctrl-D, or when `ended` turns true. Throws Interrupted at
  /// Ctrl-C; the line is dropped then.
  std::optional<std::string> read(const std::string& prompt, const std::function<bool()>& ended);

  /// Puts a line into the history and its file, where other prompts have theirs, unless it is the one before again.
  void remember(const std::string& line);

  /// Prints above the line being typed, which is shown again below, unharmed.
  void print(Stream stream, std::string_view lines);

 private:
  static LineEditor& of(::editline* editor);
  static char* prompt_of(::editline* editor);
  static unsigned char on_complete(::editline* editor, wint_t key);

  void begin_editing();
  void end_editing();
  void take_terminal_back();
  void read_character();
  /// Up to the cursor.
  std::string typed() const;
  std::size_t cursor_row() const;

  Reactor& reactor_;
  const std::filesystem::path file_;
  const Completer completer_;
  const Remembered lines_;
  std::unique_ptr<::editline, End> editor_;  ///< looks at the lines
  std::string prompt_;
  std::string last_remembered_;
  bool editing_ = false;
  bool terminated_ = false;  ///< while it completed
  bool done_ = false;
  std::optional<std::string> line_;
};

}  // namespace fiona::console
