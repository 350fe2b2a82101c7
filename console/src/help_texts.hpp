#pragma once

#include <string_view>
#include <vector>

namespace fiona::console {

/// What each exit code of `fiona` means, one a line: "7  nobody answered in time".
std::string_view exit_code_text();
/// How a line is written.
std::string_view grammar_text();

/// What `help` knows beside the verbs.
struct HelpTopic {
  std::string_view name;
  std::string_view text;
};
const std::vector<HelpTopic>& help_topics();

}  // namespace fiona::console
