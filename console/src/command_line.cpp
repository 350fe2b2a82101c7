#include "command_line.hpp"

#include <algorithm>
#include <deque>

#include <fmt/format.h>

#include "verb_table.hpp"

namespace fiona::console {
namespace {

const OptionSlot* global_option(const std::string& word) {
  const std::string name = word.substr(0, word.find('='));
  for (const GlobalOption& option : global_options()) {
    if (option.slot.name == name) return &option.slot;
  }
  return nullptr;
}

void apply(CommandLine& command, const std::string& name, const std::string& value) {
  if (name == "--json") command.manner.json = true;
  if (name == "-q") command.manner.quiet = true;
  if (name == "-v") command.manner.verbose = true;
  if (name == "--at") command.options.at = value;
  if (name == "--control") command.options.control = true;
  if (name == "--host") command.options.host = value;
  if (name == "--store") command.options.store = value;
  if (name == "--timeout") {
    const WordLine line = ready_words({name, value});
    command.options.timeout =
        std::chrono::milliseconds(static_cast<std::int64_t>(duration_ms(line.items[1].word, line)));
  }
}

/// Takes one option, and its value, from the front.
bool take_front(CommandLine& command, std::deque<std::string>& words) {
  const std::string word = words.front();
  if (word == "--help" || word == "-h") command.help = true;
  if (word == "--version") command.version = true;
  const OptionSlot* option = global_option(word);
  if (option == nullptr && !command.help && !command.version) return false;
  words.pop_front();
  if (option == nullptr) return true;
  const std::size_t equals = word.find('=');
  std::string value = equals == std::string::npos ? "" : word.substr(equals + 1);
  if (option->takes_value() && equals == std::string::npos) {
    if (words.empty())
      throw Error(ErrorCode::Usage,
                  ErrorText{.what = fmt::format("{} needs a value", option->name),
                            .expected = fmt::format("{} {}", option->name, option->slot.placeholder())});
    value = words.front();
    words.pop_front();
  }
  apply(command, option->name, value);
  return true;
}

/// Options after a single argument that is a whole line: `fiona 'ls plugins' --json`.
bool is_line_with_options(const std::deque<std::string>& words) {
  if (words.size() < 2 || words.front().find_first_of(" \t") == std::string::npos) return false;
  for (std::size_t i = 1; i < words.size(); ++i) {
    const OptionSlot* option = global_option(words[i]);
    if (option == nullptr) return false;
    if (option->takes_value() && words[i].find('=') == std::string::npos) ++i;
  }
  return true;
}

}  // namespace

CommandLine read_command_line(const std::vector<std::string>& arguments) {
  CommandLine command;
  std::deque<std::string> words(arguments.begin(), arguments.end());
  while (!words.empty() && words.front().starts_with('-') && !command.help && !command.version) {
    if (take_front(command, words)) continue;
    std::vector<std::string> known{"--help", "--version"};
    for (const GlobalOption& option : global_options()) known.push_back(option.slot.name);
    throw Error(ErrorCode::Usage, ErrorText{.what = fmt::format("there is no option {}", words.front()),
                                            .next = "fiona help",
                                            .near = nearest_names(words.front(), known)});
  }
  if (is_line_with_options(words)) {
    std::deque<std::string> trailing(words.begin() + 1, words.end());
    words.erase(words.begin() + 1, words.end());
    while (!trailing.empty()) take_front(command, trailing);
  }
  if (words.empty()) return command;
  command.line = words.size() == 1 ? split_line(words.front()) : ready_words({words.begin(), words.end()});
  // Known before the line is: its own mistakes are for programs too.
  for (const WordLine::Item& item : command.line->items)
    command.manner.json = command.manner.json || (!item.name && item.word.is_plain("--json"));
  return command;
}

}  // namespace fiona::console
