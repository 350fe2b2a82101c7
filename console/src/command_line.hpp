#pragma once

#include <optional>
#include <string>
#include <vector>

#include "output.hpp"
#include "session.hpp"

namespace fiona::console {

/// What the shell gave to `fiona`: options of the process, then one line.
struct CommandLine {
  Manner manner{};
  Options options{};
  bool help = false;
  bool version = false;
  std::optional<WordLine> line{};  ///< nothing: the prompt, or lines from standard input
};

/// Options before the first word and after the last belong to the process; one argument between them is a line, several
/// are ready words. Throws fiona::Error (Usage).
CommandLine read_command_line(const std::vector<std::string>& arguments);

}  // namespace fiona::console
