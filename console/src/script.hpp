#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "session.hpp"

namespace fiona::console {

/// Files that one script sources, in all: a few that source each other twice would be as long as one likes.
inline constexpr std::size_t kMostSourced = 1000;

/// The text of a system file. Throws fiona::Error: NotFound, or Failed where it cannot be read.
std::string read_text(const std::filesystem::path& file);

/// The lines of a file, those of a file that it sources in their place, each read by its verb's form, so that a mistake
/// in the last line is told before the first one runs.
std::vector<Line> read_script(const std::filesystem::path& file);

/// Runs the lines in order and stops at the first that fails; its error then says file:line:column. `before` is called
/// with each line before it runs. Ends early when a line was `quit`.
void run_script(Session& session, const std::vector<Line>& lines, const std::function<void(const Line&)>& before = {});

}  // namespace fiona::console
