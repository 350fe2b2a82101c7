#pragma once

#include <exception>
#include <functional>
#include <string>
#include <string_view>

#include <fiona/error.hpp>
#include <nlohmann/json.hpp>

#include "reactor.hpp"
#include "secret_names.hpp"
#include "table.hpp"

namespace fiona::console {

enum class Stream { Out, Err };

/// Whoever read the output has gone, which is the end, and nobody's failure. Exit code 141, as of a program that
/// SIGPIPE ends.
class ReaderGone : public std::exception {
 public:
  const char* what() const noexcept override { return "whoever read the output has gone"; }
};

/// How much is said and in which form.
struct Manner {
  bool json = false;
  bool quiet = false;
  bool verbose = false;
};

/// Where every word of the console goes out: inert, as lines for people or as one JSON object a line.
class Output {
 public:
  /// Receives whole lines with their newlines.
  using Sink = std::function<void(Stream, std::string_view)>;

  explicit Output(Sink sink) : sink_(std::move(sink)) {}

  /// Of the terminal that standard output is; 0: it is none.
  static std::size_t terminal_columns();

  /// To the process's standard output and error; a signal ends what waits for their readers. Throws ReaderGone, and
  /// fiona::Error (Failed) where the output cannot be written.
  static Sink standard_sink(Reactor& reactor);

  /// Replaces the sink, as a prompt does that keeps the line being typed; returns the old one.
  Sink exchange_sink(Sink sink) { return std::exchange(sink_, std::move(sink)); }

  Manner manner{};
  /// Fields whose values stand in lines that people type, and do not come out here again.
  SecretNames secrets{};
  /// How many columns of a terminal a table has; 0: it goes elsewhere.
  std::function<std::size_t()> columns = [] { return std::size_t{0}; };

  /// The answer for people, as the command's result; nothing with --json.
  void text(std::string_view lines);

  /// "It is done": nothing with -q; with --json an object {"done": …}.
  void done(std::string_view note, nlohmann::json more = nlohmann::json::object());

  /// Progress and remarks, on standard error; nothing with -q or --json.
  void remark(std::string_view lines);

  /// What was done but may not be meant so, on standard error, also with -q.
  void warning(std::string_view line);

  /// One object for programs, with "fiona": 1; nothing without --json.
  void object(nlohmann::json value);

  /// Lines for people or objects for programs; `when_empty` for people where there are no rows.
  void table(const Table& table, std::string_view when_empty, bool header = true);

  /// The error with its caret, on standard error; with --json an object {"error": …} on standard output.
  void error(const Error& error);

 private:
  void write(Stream stream, std::string_view lines);

  Sink sink_;
};

}  // namespace fiona::console
