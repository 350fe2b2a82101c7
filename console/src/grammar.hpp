#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <fiona/error.hpp>

#include "fiona/control.pb.h"
#include "secret_names.hpp"

namespace fiona::console {

/// Where a word stands: counted from 1, columns in code points, so that an editor finds it.
struct Place {
  std::size_t line = 1;
  std::size_t column = 1;

  bool operator==(const Place&) const = default;
};

/// What a word was written as; decides whether it may be a keyword, an option or a number.
enum class WordKind {
  Plain,    ///< `nav.location`, `5`, `to`
  Quoted,   ///< `"x y"`
  List,     ///< `[a, b]`
  Message,  ///< `{x_m: 1}`
};

/// One word of a line. `text` is without quotes and escapes; of a list or message it is the source as typed.
struct Word {
  std::string text{};
  WordKind kind = WordKind::Plain;
  Place place{};

  bool is_plain(std::string_view literal) const { return kind == WordKind::Plain && text == literal; }
};

/// One command line as words, before any verb is known.
struct WordLine {
  struct Item {
    Word word{};                 ///< a bare word, or the value of `name=value`
    std::optional<Word> name{};  ///< set for `name=value`
  };
  std::vector<Item> items{};
  std::string origin{};   ///< the file; empty for a typed line
  Place place{};          ///< of the first word
  std::string comment{};  ///< of the lines right above it, and at its end; lines of it
  /// The physical lines, for the caret; shared by all lines of a file, which has thousands at times.
  std::shared_ptr<const std::vector<std::string>> source{};

  bool empty() const { return items.empty(); }
};

/// The file that a line names: relative to the file in which the line stands, or to where it is typed.
std::filesystem::path named_file(const WordLine& line, const std::filesystem::path& name);

/// Bytes of a script.
constexpr std::size_t kLongestScript = 16U << 20U;

/// The command lines of a whole file; blank and comment lines leave nothing. `origin` names the file in errors.
/// Throws fiona::Error (Usage) with line, column and a caret at the first thing that cannot be read.
std::vector<WordLine> split_script(std::string_view text, const std::string& origin);

/// One typed line. An empty line or a comment gives an empty WordLine; a second command is an error.
WordLine split_line(std::string_view text, const std::string& origin = "");

/// Words that a shell has split already: each stays one word, whatever blanks or quotes it has inside.
WordLine ready_words(const std::vector<std::string>& words);

/// True when the typed text ends in the `\` that continues a line, so that a prompt asks for more.
bool continues(std::string_view text);

/// The word as a value: number with unit, true or false, list, protobuf text, or text.
control::Value value_of(const Word& word, const WordLine& line);

/// A value as the grammar reads it back: value_of(typed(v)) gives v.
std::string typed(const control::Value& value);

/// A text as one word, quoted when it must be.
std::string quoted_word(std::string_view text);

/// Like quoted_word, and also quoted where the bare word would be read as a number, flag or keyword.
std::string typed_text(std::string_view text);

/// `1.5s`, `200ms`, `2min` in milliseconds. Throws fiona::Error (Usage) without a unit of time or when negative.
double duration_ms(const Word& word, const WordLine& line);

/// A count of at least one.
unsigned count_of(const Word& word, const WordLine& line);

/// `instance.port`.
control::PortName port_name(const Word& word, const WordLine& line);

/// A push port or a probe: `instance.port`, `instance.probe`, `instance.port.probe`.
control::PortName watched_name(const Word& word, const WordLine& line);

/// An error about one word of a line: `where` is file:line:column, and `caret` shows the word.
class LineError : public Error {
 public:
  LineError(const WordLine& line, const Place& place, ErrorText text, ErrorCode code = ErrorCode::Usage);

  /// The source line, with `*` for what of it is secret, and below it a caret: two inert lines without a newline at the
  /// end; empty when unknown.
  std::string caret(const SecretNames& secrets = {}) const;
  /// Whether the word that it is about may be part of a secret, which the text is likely to repeat.
  bool is_in_secret(const SecretNames& secrets) const;

 private:
  std::shared_ptr<const std::vector<std::string>> source_;
  Place place_;
};

/// "file:line:column"; "column 5" of a typed line.
std::string place_text(const WordLine& line, const Place& place);

bool is_keyword(std::string_view word);

}  // namespace fiona::console
