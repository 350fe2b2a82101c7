#pragma once

#include <fiona/plugin.hpp>

namespace fiona::test {

/// Those that hold single sentences of docs/patterns.md to account.
void add_pattern_components(Plugin& plugin);

}  // namespace fiona::test
