#pragma once

#include <vector>

#include "grammar.hpp"

namespace fiona::console::detail {

/// The elements of a word of kind List, each with its place in the line.
std::vector<Word> list_elements(const Word& list, const WordLine& line);

}  // namespace fiona::console::detail
