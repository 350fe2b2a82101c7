#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "completion.hpp"
#include "output.hpp"
#include "reactor.hpp"

namespace fiona::console {

/// The line that a person types in a terminal: libedit behind its readline calls, served by the reactor. One at a time,
/// since that library has one state per process.
class LineEditor {
 public:
  /// Called with what is typed up to the cursor.
  using Completer = std::function<Completion(std::string_view)>;

  LineEditor(Reactor& reactor, std::filesystem::path history, Completer completer);
  LineEditor(const LineEditor&) = delete;
  LineEditor& operator=(const LineEditor&) = delete;
  ~LineEditor();

  /// Shows the prompt and waits for a line; nothing at Ctrl-D, or when `ended` turns true. Throws Interrupted at
  /// Ctrl-C; the line is dropped then.
  std::optional<std::string> read(const std::string& prompt, const std::function<bool()>& ended);

  /// Puts a line into the history, unless it is the one before again.
  void remember(const std::string& line);

  /// Prints above the line being typed, which is shown again below, unharmed.
  void print(Stream stream, std::string_view lines);

  /// Whether something is typed already.
  bool has_text() const;

 private:
  static void on_line(char* line);
  static char** on_complete(const char* text, int start, int end);
  static LineEditor*& current();

  void begin_editing();
  void end_editing();
  void read_character();
  std::size_t cursor_row() const;

  Reactor& reactor_;
  const std::filesystem::path history_;
  const Completer completer_;
  std::string prompt_;
  std::string last_remembered_;
  bool editing_ = false;
  bool terminated_ = false;  ///< while it completed
  bool done_ = false;
  std::optional<std::string> line_;
};

}  // namespace fiona::console
