#include "grammar.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include <fmt/format.h>

#include "inert.hpp"
#include "scanner.hpp"

namespace fiona::console {
namespace {

constexpr std::size_t kMostComment = 4096;  // of one line, bytes; what is longer loses its end
constexpr std::array<std::string_view, 9> kKeywords{"as", "in", "to", "else", "for", "with", "at", "every", "when"};

std::shared_ptr<const std::vector<std::string>> physical_lines(std::string_view text) {
  std::vector<std::string> lines;
  while (true) {
    const std::size_t end = text.find('\n');
    std::string_view line = text.substr(0, end);
    if (line.ends_with('\r')) line.remove_suffix(1);
    lines.emplace_back(line);
    if (end == std::string_view::npos) break;
    text.remove_prefix(end + 1);
  }
  return std::make_shared<const std::vector<std::string>>(std::move(lines));
}

std::optional<WordLine> next_line(Scanner& scanner, const WordLine& frame) {
  WordLine line = frame;
  for (scanner.skip_blanks(); !scanner.at_end() && scanner.peek() != '\n'; scanner.skip_blanks()) {
    if (line.items.empty()) line.place = scanner.place();
    if (scanner.peek() == '\\') {
      const bool last = scanner.rest().size() == 1;
      scanner.fail(scanner.place(),
                   {.what = last ? "the line goes on after \\, and nothing follows" : "a \\ stands outside of quotes",
                    .next = last ? "write the rest, or take the \\ away" : "quote the word and write \\\\"});
    }
    WordLine::Item item;
    item.name = scanner.take_name();
    if (item.name && scanner.at_word_end()) {
      scanner.fail(scanner.place(), {.what = fmt::format("no value follows {}=", item.name->text),
                                     .expected = "a value without a blank before it; \"\" is the empty text"});
    }
    item.word = scanner.take_word();
    line.items.push_back(std::move(item));
  }
  if (!scanner.at_end()) scanner.advance();
  if (line.empty()) return std::nullopt;
  return line;
}

WordLine frame_of(std::string_view text, const std::string& origin) {
  WordLine frame;
  frame.origin = origin;
  frame.source = physical_lines(text);
  return frame;
}

/// Where in a physical line the column is, in bytes.
std::size_t offset_of(std::size_t column, std::string_view line) {
  std::size_t offset = line.starts_with("\xef\xbb\xbf") ? 3 : 0;
  for (; column > 1 && offset < line.size(); --column) offset += decode(line.substr(offset)).bytes;
  return offset;
}

/// From where on a physical line is not to be shown; a value may have begun in a line that goes on with it.
std::size_t secret_begin(const std::vector<std::string>& lines, std::size_t number, const SecretNames& secrets) {
  std::size_t first = number;
  while (first > 0 && lines[first - 1].ends_with('\\')) --first;
  std::string before;
  for (std::size_t i = first; i < number; ++i) before += lines[i] + "\n";
  const std::size_t begin = secrets.begin_in(before + lines[number]);
  return begin == std::string::npos ? begin : begin - std::min(begin, before.size());
}

std::string stars(std::string_view text) {
  std::string out;
  for (; !text.empty(); text.remove_prefix(decode(text).bytes)) out += '*';
  return out;
}

std::string made_caret(const std::string& source, std::size_t column) {
  const std::size_t before = offset_of(column, source);
  // A long line is shown around the word only.
  constexpr std::size_t kShownBefore = 60;
  constexpr std::size_t kShown = 100;
  const std::string lead = inert(std::string_view(source).substr(0, before));
  const bool cut = display_width(lead) > kShownBefore;
  std::string shown = cut ? "…" : lead;
  const std::size_t width = display_width(shown);
  std::string_view rest = std::string_view(source).substr(before);
  std::size_t bytes = 0;
  for (std::size_t count = 0; count < kShown && bytes < rest.size(); ++count) bytes += decode(rest.substr(bytes)).bytes;
  shown += inert(rest.substr(0, bytes));
  if (bytes < rest.size()) shown += "…";
  return fmt::format("{}\n{}^", shown, std::string(width, ' '));
}

ErrorText placed(ErrorText text, const WordLine& line, const Place& place) {
  const std::string where = place_text(line, place);
  // Of a typed line the caret says where; a file needs its name and line as well.
  if (text.where.empty())
    text.where = where;
  else if (!line.origin.empty())
    text.where = where + ", " + text.where;
  return text;
}

}  // namespace

LineError::LineError(const WordLine& line, const Place& place, ErrorText text, ErrorCode code)
    : Error(code, placed(std::move(text), line, place)), source_(line.source), place_(place) {}

std::string LineError::caret(const SecretNames& secrets) const {
  if (!source_ || place_.line == 0 || place_.line > source_->size()) return {};
  const std::string& line = (*source_)[place_.line - 1];
  const std::size_t hidden = std::min(secret_begin(*source_, place_.line - 1, secrets), line.size());
  return made_caret(line.substr(0, hidden) + stars(std::string_view(line).substr(hidden)), place_.column);
}

bool LineError::is_in_secret(const SecretNames& secrets) const {
  if (!source_ || place_.line == 0 || place_.line > source_->size()) return false;
  const std::string& line = (*source_)[place_.line - 1];
  const std::size_t hidden = secret_begin(*source_, place_.line - 1, secrets);
  return hidden < line.size() && offset_of(place_.column, line) >= hidden;
}

std::string place_text(const WordLine& line, const Place& place) {
  if (!line.origin.empty()) return fmt::format("{}:{}:{}", line.origin, place.line, place.column);
  if (line.source && line.source->size() > 1) return fmt::format("line {}, column {}", place.line, place.column);
  return fmt::format("column {}", place.column);
}

std::filesystem::path named_file(const WordLine& line, const std::filesystem::path& name) {
  return name.is_relative() && !line.origin.empty() ? std::filesystem::path(line.origin).parent_path() / name : name;
}

bool is_keyword(std::string_view word) {
  return std::find(kKeywords.begin(), kKeywords.end(), word) != kKeywords.end();
}

std::vector<WordLine> split_script(std::string_view text, const std::string& origin) {
  if (text.size() > kLongestScript) {
    throw Error(ErrorCode::Usage, ErrorText{.what = "the script is too long",
                                            .where = origin,
                                            .expected = "at most 16 MiB",
                                            .found = fmt::format("{} bytes", text.size())});
  }
  const WordLine frame = frame_of(text, origin);
  Scanner scanner(text, frame);
  std::vector<WordLine> lines;
  std::string above;
  while (!scanner.at_end()) {
    auto line = next_line(scanner, frame);
    const std::string comment = scanner.take_comment();
    const bool fits = above.size() + comment.size() < kMostComment;
    if (!line) {
      above = comment.empty() ? "" : fits ? above + comment + "\n" : above;
      continue;
    }
    line->comment = std::exchange(above, {}) + (fits ? comment : "");
    if (line->comment.ends_with('\n')) line->comment.pop_back();
    lines.push_back(std::move(*line));
  }
  return lines;
}

WordLine split_line(std::string_view text, const std::string& origin) {
  std::vector<WordLine> lines = split_script(text, origin);
  if (lines.size() > 1)
    throw LineError(lines[1], lines[1].place, {.what = "a second command begins here", .expected = "one command"});
  return lines.empty() ? frame_of(text, origin) : std::move(lines.front());
}

WordLine ready_words(const std::vector<std::string>& words) {
  std::string shown;
  std::vector<Place> places;
  for (const std::string& word : words) {
    if (!shown.empty()) shown += ' ';
    std::size_t column = 1;
    for (std::string_view rest = shown; !rest.empty(); rest.remove_prefix(decode(rest).bytes)) ++column;
    places.push_back({1, column});
    shown += inert(word);
  }
  WordLine line = frame_of(shown, "");
  for (std::size_t i = 0; i < words.size(); ++i) {
    for (std::string_view rest = words[i]; !rest.empty(); rest.remove_prefix(decode(rest).bytes)) {
      if (!decode(rest).valid)
        throw LineError(line, places[i], {.what = "this word is not UTF-8", .expected = "UTF-8: see locale"});
    }
    WordLine::Item item;
    std::string_view value = words[i];
    Scanner scanner(value, line, places[i]);
    item.name = scanner.take_name();
    item.word = {.text = std::string(item.name ? scanner.rest() : value),
                 .kind = WordKind::Plain,
                 .place = item.name ? scanner.place() : places[i]};
    const char first = scanner.peek();
    const bool bracketed = first == '[' || first == '{';
    if (bracketed || (item.name && first == '"')) {
      item.word = scanner.take_word();
      if (!scanner.at_end())
        scanner.fail(scanner.place(), {.what = "more follows after the value", .next = "quote the whole value"});
    } else if (item.word.text.empty() || item.word.text.find_first_of(" \t\n") != std::string::npos) {
      item.word.kind = WordKind::Quoted;
    }
    line.items.push_back(std::move(item));
  }
  return line;
}

bool continues(std::string_view text) {
  // Only a \ that the scanner would take as the end of the line counts, not one in a comment.
  if (!text.ends_with('\\')) return false;
  const std::string joined = std::string(text) + "\n#";
  const WordLine frame = frame_of(joined, "");
  try {
    Scanner scanner(joined, frame);
    for (scanner.skip_blanks(); !scanner.at_end() && scanner.peek() != '\n'; scanner.skip_blanks()) {
      scanner.take_name();
      scanner.take_word();
    }
    return scanner.at_end();
  } catch (const Error&) {
    return true;  // an open quote or bracket goes on in the next line; other mistakes are told when it is whole
  }
}

}  // namespace fiona::console
