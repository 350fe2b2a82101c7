#pragma once

#include <string>

#include "fiona/control.pb.h"

namespace fiona::console {

/// The wiring as text that reads from those who only provide to those who only require: a block for each instance, what
/// comes to it (`<-`), what nobody serves (`?-`), and what goes from it (`->`).
std::string text_graph(const control::System& system);

/// The same for Graphviz and for Mermaid: an edge for each wire, a dashed one where it does not work, a dotted node for
/// each required port that nobody serves. Names are escaped as the languages demand.
std::string dot_graph(const control::System& system);
std::string mermaid_graph(const control::System& system);

}  // namespace fiona::console
