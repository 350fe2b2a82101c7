#include "output.hpp"

#include <cerrno>
#include <cstring>

#include <sys/ioctl.h>
#include <unistd.h>

#include <fmt/format.h>

#include "grammar.hpp"
#include "inert.hpp"

namespace fiona::console {
namespace {

nlohmann::json error_object(const Error& error) {
  const ErrorText& text = error.text();
  nlohmann::json object{{"code", static_cast<int>(error.code())}, {"what", text.what}};
  const auto add = [&object](const char* key, const std::string& value) {
    if (!value.empty()) object[key] = value;
  };
  add("where", text.where);
  add("expected", text.expected);
  add("found", text.found);
  add("next", text.next);
  if (!text.near.empty()) object["near"] = text.near;
  return object;
}

/// In the place of an error whose text may repeat a part of a secret.
Error untold(const LineError& error) {
  return Error(error.code(), {.what = "this cannot be read; it may be part of a secret and is not repeated",
                              .where = error.text().where,
                              .next = "quote a value that has blanks in it: name=\"a b\""});
}

}  // namespace

std::size_t Output::terminal_columns() {
  winsize size{};
  return ::isatty(STDOUT_FILENO) == 1 && ::ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 ? size.ws_col : 0;
}

Output::Sink Output::standard_sink(Reactor& reactor) {
  return [&reactor](Stream stream, std::string_view lines) {
    // Of standard error that cannot be written nobody could be told.
    if (stream == Stream::Err) return static_cast<void>(reactor.write_all(STDERR_FILENO, lines));
    if (reactor.write_all(STDOUT_FILENO, lines)) return;
    if (errno == EPIPE) throw ReaderGone();
    throw Error(ErrorCode::Failed,
                ErrorText{.what = fmt::format("the output cannot be written: {}", std::strerror(errno)),
                          .where = "standard output",
                          .next = "see where it goes, and whether the disk is full: df -h; what it tells may have been done"});
  };
}

void Output::write(Stream stream, std::string_view lines) {
  while (lines.ends_with('\n')) lines.remove_suffix(1);
  sink_(stream, inert_lines(lines) + "\n");
}

void Output::text(std::string_view lines) {
  if (!manner.json) write(Stream::Out, lines);
}

void Output::done(std::string_view note, nlohmann::json more) {
  more["done"] = note;
  object(std::move(more));
  if (!manner.json && !manner.quiet && !note.empty()) write(Stream::Out, note);
}

void Output::remark(std::string_view lines) {
  if (!manner.json && !manner.quiet) write(Stream::Err, lines);
}

void Output::warning(std::string_view line) {
  if (manner.json) return object({{"warning", std::string(line)}});
  write(Stream::Err, fmt::format("warning: {}", line));
}

void Output::object(nlohmann::json value) {
  if (!manner.json) return;
  value["fiona"] = 1;
  write(Stream::Out, value.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace));
}

void Output::table(const Table& table, std::string_view when_empty, bool header) {
  for (auto& row : table.objects()) object(std::move(row));
  if (table.empty() && !when_empty.empty()) text(when_empty);
  if (table.empty()) return;
  std::string lines;
  for (const std::string& line : table.lines(header, columns())) lines += line + "\n";
  text(lines);
}

void Output::error(const Error& error) {
  const auto* placed = dynamic_cast<const LineError*>(&error);
  const Error told = placed != nullptr && placed->is_in_secret(secrets) ? untold(*placed) : error;
  if (manner.json) return object({{"error", error_object(told)}});
  std::string text = fmt::format("error: {}", told.what());
  const std::string source = placed != nullptr ? placed->caret(secrets) : "";
  if (!source.empty()) {
    std::string caret;
    for (const char c : "\n" + source) caret += c == '\n' ? std::string("\n  ") : std::string(1, c);
    const std::size_t first_line = text.find('\n');
    text.insert(first_line == std::string::npos ? text.size() : first_line, caret);
  }
  write(Stream::Err, text);
}

}  // namespace fiona::console
