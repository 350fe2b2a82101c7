#include "shape.hpp"

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace fiona::console {
namespace {

constexpr std::string_view kMore = "…";

std::vector<std::string> split(std::string_view text, char mark) {
  std::vector<std::string> parts;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find(mark), text.size());
    if (end > 0) parts.emplace_back(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return parts;
}

bool is_placeholder(std::string_view choice) {
  return !choice.empty() && std::isupper(static_cast<unsigned char>(choice[0])) != 0;
}
bool is_option(std::string_view word) {
  return word.size() >= 2 && word[0] == '-' &&
         (std::islower(static_cast<unsigned char>(word[1])) != 0 || (word[1] == '-' && word.size() > 2));
}

/// Words of a form with the brackets taken off: whether each is in brackets, and whether "…" follows.
struct FormWord {
  std::string text;
  bool optional = false;
  bool repeated = false;
};

std::vector<FormWord> form_words(std::string_view form) {
  std::vector<FormWord> words;
  bool optional = false;
  for (std::string part : split(form, ' ')) {
    if (part.starts_with('[')) {
      optional = true;
      part.erase(0, 1);
    }
    const bool closes = part.ends_with(']');
    if (closes) part.pop_back();
    if (part == kMore) {
      words.back().repeated = true;
    } else {
      words.push_back({part, optional, false});
    }
    if (closes) optional = false;
  }
  return words;
}

/// Fills a Line item by item.
class Binder {
 public:
  Binder(const WordLine& words, const Shape& shape, const std::vector<OptionSlot>& global_options)
      : shape_(shape), global_options_(global_options) {
    line_.words = words;
    line_.verb = words.items.front().word;
  }

  Line bind() {
    for (at_ = 1; at_ < items().size(); ++at_) take(items()[at_]);
    check_whole();
    return std::move(line_);
  }

 private:
  const std::vector<WordLine::Item>& items() const { return line_.words.items; }

  [[noreturn]] void fail(const Place& place, ErrorText text) const {
    if (text.expected.empty()) text.expected = shape_.text();
    throw LineError(line_.words, place, std::move(text));
  }

  void take(const WordLine::Item& item) {
    if (item.name) return take_argument(item);
    if (item.word.kind == WordKind::Plain && is_option(item.word.text)) return take_option(item.word);
    if (item.word.kind == WordKind::Plain && begins_clause(item.word.text)) return take_clause(item.word);
    take_positional(item.word);
  }

  /// A word that is a keyword in this form only may also be a name, where one is still to come.
  bool begins_clause(const std::string& word) const {
    return is_keyword(word) ||
           (shape_.find_clause(word) != nullptr && line_.positional.size() >= shape_.positional().size());
  }

  void take_argument(const WordLine::Item& item) {
    const std::string option = "--" + item.name->text;
    if (shape_.find_option(option) != nullptr && shape_.find_argument(item.name->text) == nullptr && !takes_any())
      fail(item.name->place, {.what = fmt::format("{} takes no {}=…", line_.verb.text, item.name->text),
                              .next = fmt::format("{} {}", option, item.word.text)});
    if (!shape_.takes_arguments())
      fail(item.name->place, {.what = fmt::format("{} takes no {}=…", line_.verb.text, item.name->text)});
    if (!shape_.arguments().empty() && shape_.find_argument(item.name->text) == nullptr) {
      std::vector<std::string> names;
      for (const ArgumentSlot& argument : shape_.arguments()) names.push_back(argument.name);
      fail(item.name->place, {.what = fmt::format("{} takes no {}=…", line_.verb.text, item.name->text),
                              .near = nearest_names(item.name->text, names)});
    }
    const auto same = [&item](const TypedArgument& known) { return known.name.text == item.name->text; };
    if (std::any_of(line_.arguments.begin(), line_.arguments.end(), same))
      fail(item.name->place, {.what = fmt::format("{} is given twice", item.name->text)});
    line_.arguments.push_back({*item.name, item.word});
  }

  /// Names that only a component knows.
  bool takes_any() const { return shape_.takes_arguments() && shape_.arguments().empty(); }

  void take_option(Word word) {
    const std::size_t equals = word.text.find('=');
    const std::string name = word.text.substr(0, equals);
    const OptionSlot* option = shape_.find_option(name);
    for (const OptionSlot& global : global_options_)
      option = option == nullptr && global.name == name ? &global : option;
    if (option == nullptr) fail(word.place, unknown_option(name));
    TypedArgument given;
    if (equals != std::string::npos && !option->takes_value())
      fail(word.place, {.what = fmt::format("{} takes no value", name)});
    if (equals != std::string::npos) {
      given.value = {word.text.substr(equals + 1), WordKind::Plain, {word.place.line, word.place.column + equals + 1}};
    } else if (option->takes_value()) {
      if (++at_ >= items().size())
        fail(word.place, {.what = fmt::format("{} needs a value", name),
                          .expected = fmt::format("{} {}", name, fmt::join(option->slot.choices, "|"))});
      given.value = items()[at_].word;
      if (items()[at_].name) given.name = *items()[at_].name;
    }
    if (!option->slot.repeated && line_.has(name)) fail(word.place, {.what = fmt::format("{} is given twice", name)});
    line_.options.emplace(name, std::move(given));
  }

  ErrorText unknown_option(const std::string& name) const {
    std::vector<std::string> known;
    for (const OptionSlot& option : shape_.options()) known.push_back(option.name);
    for (const OptionSlot& option : global_options_) known.push_back(option.name);
    const std::string argument = name.substr(std::min(name.find_first_not_of('-'), name.size()));
    return {.what = fmt::format("{} does not know {}", line_.verb.text, name),
            .next = shape_.find_argument(argument) == nullptr ? fmt::format("help {}", line_.verb.text)
                                                              : fmt::format("{}=…", argument),
            .near = nearest_names(name, known)};
  }

  void take_clause(const Word& keyword) {
    const Clause* clause = shape_.find_clause(keyword.text);
    if (clause == nullptr)
      fail(keyword.place, {.what = fmt::format("'{}' does not belong to {} here", keyword.text, line_.verb.text),
                           .next = fmt::format("a name that is a keyword is written in quotes: \"{}\"", keyword.text)});
    if (line_.clauses.contains(keyword.text) && !clause->slot.repeated)
      fail(keyword.place, {.what = fmt::format("'{}' is given twice", keyword.text)});
    const bool there = at_ + 1 < items().size() && !items()[at_ + 1].name;
    if (!there)
      fail(keyword.place, {.what = fmt::format("a word is missing after '{}'", keyword.text),
                           .expected = fmt::format("{} {}", keyword.text, fmt::join(clause->slot.choices, "|"))});
    auto& words = line_.clauses[keyword.text];
    words.push_back(items()[++at_].word);
    if (!clause->slot.accepts(words.back()))
      fail(words.back().place, {.what = fmt::format("'{}' cannot follow '{}'", words.back().text, keyword.text),
                                .expected = fmt::format("{} {}", keyword.text, fmt::join(clause->slot.choices, "|"))});
    while (clause->slot.repeated && at_ + 1 < items().size() && is_bare_word(items()[at_ + 1])) {
      words.push_back(items()[++at_].word);
    }
  }

  static bool is_bare_word(const WordLine::Item& item) {
    if (item.name) return false;
    return item.word.kind != WordKind::Plain || (!is_option(item.word.text) && !is_keyword(item.word.text));
  }

  void take_positional(const Word& word) {
    const std::vector<Slot>& slots = shape_.positional();
    const std::size_t next = line_.positional.size();
    const bool more = !slots.empty() && slots.back().repeated;
    if (next >= slots.size() && !more)
      fail(word.place, {.what = slots.empty() ? fmt::format("{} takes no '{}'", line_.verb.text, word.text)
                                              : fmt::format("'{}' is one word too many", word.text)});
    const Slot& slot = slots[std::min(next, slots.size() - 1)];
    if (!slot.accepts(word)) {
      fail(word.place, {.what = fmt::format("'{}' cannot stand here", word.text),
                        .expected = fmt::format("{}", fmt::join(slot.choices, ", ")),
                        .near = nearest_names(word.text, slot.literals())});
    }
    line_.positional.push_back(word);
  }

  void check_whole() const {
    const Place& place = line_.verb.place;
    const std::vector<Slot>& slots = shape_.positional();
    if (line_.positional.size() < slots.size() && slots[line_.positional.size()].required) {
      fail(place, {.what = fmt::format("{} needs {}", line_.verb.text,
                                       fmt::join(slots[line_.positional.size()].choices, "|"))});
    }
    for (const Clause& clause : shape_.clauses()) {
      if (clause.slot.required && !line_.clauses.contains(clause.keyword))
        fail(place, {.what = fmt::format("{} needs '{} {}'", line_.verb.text, clause.keyword,
                                         fmt::join(clause.slot.choices, "|"))});
    }
    if (shape_.needs_arguments() && line_.arguments.empty())
      fail(place, {.what = fmt::format("{} needs at least one name=value", line_.verb.text)});
  }

  Line line_;
  const Shape& shape_;
  const std::vector<OptionSlot>& global_options_;
  std::size_t at_ = 0;
};

}  // namespace

std::string Slot::placeholder() const {
  const auto found = std::find_if(choices.begin(), choices.end(), is_placeholder);
  return found == choices.end() ? "" : *found;
}

std::vector<std::string> Slot::literals() const {
  std::vector<std::string> literals;
  std::copy_if(choices.begin(), choices.end(), std::back_inserter(literals),
               [](const std::string& choice) { return !is_placeholder(choice); });
  return literals;
}

bool Slot::accepts(const Word& word) const {
  return !placeholder().empty() || std::any_of(choices.begin(), choices.end(),
                                               [&word](const std::string& choice) { return word.is_plain(choice); });
}

namespace {

/// `[watch T]`: a keyword of this form alone.
bool is_own_keyword(const std::vector<FormWord>& words, std::size_t at) {
  const FormWord& word = words[at];
  const bool followed = at + 1 < words.size() && words[at + 1].optional && is_placeholder(words[at + 1].text);
  return word.optional && followed && !is_placeholder(word.text) && word.text.find('|') == std::string::npos;
}

}  // namespace

Shape::Shape(std::string_view form) : text_(form) {
  std::vector<FormWord> words = form_words(form);
  for (std::size_t i = 1; i < words.size(); ++i) {
    FormWord word = words[i];
    const auto take_slot = [&words, &word, &i] {
      const FormWord& value = words[++i];
      return Slot{split(value.text, '|'), !word.optional, value.repeated};
    };
    if (is_option(word.text)) {
      const bool has_value = i + 1 < words.size() && words[i + 1].optional && is_placeholder(words[i + 1].text);
      options_.push_back({word.text, has_value ? take_slot() : Slot{{}, false, false}});
    } else if (is_keyword(word.text) || is_own_keyword(words, i)) {
      clauses_.push_back({word.text, take_slot()});
    } else if (word.text == "PARAM=VALUE" || word.text == "FIELD=VALUE") {
      takes_arguments_ = true;
      needs_arguments_ = !word.optional;
    } else if (const std::size_t equals = word.text.find('='); equals != std::string::npos) {
      takes_arguments_ = true;
      const std::string value = word.text.substr(equals + 1);
      arguments_.push_back({word.text.substr(0, equals), {split(value, '|'), !word.optional, word.repeated}});
    } else {
      positional_.push_back({split(word.text, '|'), !word.optional, word.repeated});
    }
  }
}

const Clause* Shape::find_clause(std::string_view keyword) const {
  const auto found = std::find_if(clauses_.begin(), clauses_.end(),
                                  [keyword](const Clause& clause) { return clause.keyword == keyword; });
  return found == clauses_.end() ? nullptr : &*found;
}

const OptionSlot* Shape::find_option(std::string_view name) const {
  const auto found =
      std::find_if(options_.begin(), options_.end(), [name](const OptionSlot& option) { return option.name == name; });
  return found == options_.end() ? nullptr : &*found;
}

const ArgumentSlot* Shape::find_argument(std::string_view name) const {
  const auto found = std::find_if(arguments_.begin(), arguments_.end(),
                                  [name](const ArgumentSlot& argument) { return argument.name == name; });
  return found == arguments_.end() ? nullptr : &*found;
}

const Word* Line::clause(std::string_view keyword) const {
  const auto found = clauses.find(keyword);
  return found == clauses.end() ? nullptr : &found->second.front();
}

std::vector<Word> Line::clause_words(std::string_view keyword) const {
  const auto found = clauses.find(keyword);
  return found == clauses.end() ? std::vector<Word>{} : found->second;
}

const Word* Line::argument(std::string_view name) const {
  const auto found =
      std::find_if(arguments.begin(), arguments.end(), [name](const auto& one) { return one.name.text == name; });
  return found == arguments.end() ? nullptr : &found->value;
}

const Word* Line::option(std::string_view name) const {
  const auto found = options.find(name);
  return found == options.end() ? nullptr : &found->second.value;
}

std::vector<control::Argument> Line::control_arguments() const {
  std::vector<control::Argument> out;
  for (const TypedArgument& argument : arguments) {
    control::Argument& added = out.emplace_back();
    added.set_name(argument.name.text);
    *added.mutable_value() = value_of(argument.value, words);
  }
  return out;
}

namespace {

/// `~/x`, as a shell reads it, which does not see what is typed at a prompt or stands in a file.
void expand_home(Word& word, const Slot& slot) {
  const std::string kind = slot.placeholder();
  if (kind != "FILE" && kind != "DIR" && kind != "LIBRARY" && kind != "PLUGIN") return;
  const char* home = std::getenv("HOME");
  if (word.kind == WordKind::Plain && word.text.starts_with("~/") && home != nullptr) word.text.replace(0, 1, home);
}

void expand_home(Line& line, const Shape& shape, const std::vector<OptionSlot>& global_options) {
  const auto& slots = shape.positional();
  for (std::size_t i = 0; i < line.positional.size() && !slots.empty(); ++i)
    expand_home(line.positional[i], slots[std::min(i, slots.size() - 1)]);
  for (auto& [keyword, words] : line.clauses) {
    for (Word& word : words) expand_home(word, shape.find_clause(keyword)->slot);
  }
  for (TypedArgument& argument : line.arguments) {
    if (const ArgumentSlot* known = shape.find_argument(argument.name.text)) expand_home(argument.value, known->slot);
  }
  const auto expand_option = [&line](const OptionSlot& option) {
    const auto [first, last] = line.options.equal_range(option.name);
    for (auto one = first; one != last; ++one) expand_home(one->second.value, option.slot);
  };
  std::for_each(shape.options().begin(), shape.options().end(), expand_option);
  std::for_each(global_options.begin(), global_options.end(), expand_option);
}

}  // namespace

Line bind(const WordLine& words, const Shape& shape, const std::vector<OptionSlot>& global_options) {
  Line line = Binder(words, shape, global_options).bind();
  expand_home(line, shape, global_options);
  return line;
}

}  // namespace fiona::console
