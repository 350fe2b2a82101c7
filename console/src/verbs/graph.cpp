#include "../wiring_graph.hpp"

#include "verbs.hpp"

namespace fiona::console::verbs {

void graph(Session& session, const Line& line) {
  const control::System system = session.snapshot();
  const std::string kind = line.positional.empty() ? "text" : line.positional[0].text;
  std::string text = kind == "dot" ? dot_graph(system) : kind == "mermaid" ? mermaid_graph(system) : text_graph(system);
  session.out.object({{"graph", kind}, {"text", text}});
  if (text.empty()) return session.out.text("nothing is loaded\n  next: load PLUGIN [as NAME]   (ls plugins)");
  text.pop_back();  // the last newline
  session.out.text(text);
}

}  // namespace fiona::console::verbs
