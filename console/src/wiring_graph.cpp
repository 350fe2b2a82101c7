#include "wiring_graph.hpp"

#include <map>
#include <set>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "inert.hpp"
#include "system_view.hpp"

namespace fiona::console {
namespace {

/// A client port and one of its providers; without one, a white spot.
struct Edge {
  std::string client;  ///< instances
  std::string client_port;
  std::string provider;  ///< empty: nobody serves
  std::string provider_port;
  std::string service;
  std::string trouble;  ///< empty: it works
  double rate_hz = 0;
  bool serves = true;  ///< false: an alternative that waits for its turn
};

std::vector<Edge> edges_of(const control::System& system) {
  std::vector<Edge> edges;
  for (const auto& instance : system.instances()) {
    for (const auto& port : instance.ports()) {
      const std::string service = short_name(port.service());
      for (const auto& attached : port.attached())
        edges.push_back({attached.name(), "", instance.name(), port.name(), service, "", port.rate_hz(), true});
      if (port.direction() != fiona::REQUIRES) continue;
      const std::string trouble = port.connection() == control::CONNECTED ? "" : connection_text(port);
      for (const auto& one : port.providers())
        edges.push_back({instance.name(), port.name(), one.provider().instance(), one.provider().port(), service,
                         one.fit() ? "" : alternative_text(one), one.serves() ? port.rate_hz() : 0, one.serves()});
      if (port.providers().empty())
        edges.push_back({instance.name(), port.name(), port.peer().instance(), port.peer().port(), service, trouble,
                         port.rate_hz(), true});
    }
  }
  return edges;
}

/// Providers before their clients; else, and where a circle has to begin, as they were loaded.
class FlowOrder {
 public:
  FlowOrder(const control::System& system, const std::vector<Edge>& edges) : system_(system) {
    for (const Edge& edge : edges) providers_[edge.client].push_back(edge.provider);
    for (const auto& instance : system.instances()) visit(instance);
  }
  std::vector<const control::InstanceStatus*> take() { return std::move(order_); }

 private:
  void visit(const control::InstanceStatus& instance) {
    if (!visited_.insert(instance.name()).second) return;
    for (const std::string& name : providers_[instance.name()]) {
      if (const auto* provider = find_instance(system_, name)) visit(*provider);
    }
    order_.push_back(&instance);
  }

  const control::System& system_;
  std::map<std::string, std::vector<std::string>> providers_;
  std::set<std::string> visited_;
  std::vector<const control::InstanceStatus*> order_;
};

std::string label_of(const Edge& edge) {
  if (!edge.trouble.empty()) return edge.trouble;
  if (!edge.serves) return "ready";
  return edge.rate_hz > 0 ? rate_text(edge.rate_hz) : "";
}

std::string with_label(std::string text, const std::string& label) {
  return label.empty() ? text : text + "  " + label;
}

std::string port_text(const std::string& instance, const std::string& port) {
  return port.empty() ? instance : instance + "." + port;
}

/// In double quotes: backslash and quote escaped, everything else inert.
std::string dot_quoted(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : inert(text)) {
    if (c == '"' || c == '\\') quoted += '\\';
    quoted += c;
  }
  return quoted + "\"";
}

/// Mermaid has no escapes in its quotes but the entities of HTML.
std::string mermaid_quoted(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : inert(text)) {
    if (c == '"') {
      quoted += "#quot;";
    } else if (c == '#' || c == '<' || c == '>' || c == '&') {
      quoted += fmt::format("#{};", static_cast<int>(c));
    } else {
      quoted += c;
    }
  }
  return quoted + "\"";
}

std::string edge_text(const Edge& edge) {
  std::string ports = edge.client_port.empty() ? edge.provider_port : edge.provider_port + " to " + edge.client_port;
  const std::string label = label_of(edge);
  return label.empty() ? ports : ports + ", " + label;
}

/// A language of nodes and edges.
struct Notation {
  std::string begin;
  std::string end;
  std::string (*node)(const std::string& id, const std::string& label, bool spot);
  std::string (*edge)(const std::string& from, const std::string& to, const std::string& label, bool works);
};

std::string drawn(const control::System& system, const Notation& notation) {
  const auto edges = edges_of(system);
  std::string text = notation.begin;
  std::map<std::string, std::string> ids;
  const auto id_of = [&](const std::string& name, const std::string& label, bool spot) {
    const auto [at, is_new] = ids.emplace(name, fmt::format("n{}", ids.size()));
    if (is_new) text += notation.node(at->second, label, spot);
    return at->second;
  };
  for (const auto* instance : FlowOrder(system, edges).take())
    id_of(instance->name(), fmt::format("{} ({})", instance->name(), instance->mode()), false);
  for (const Edge& edge : edges) {
    const std::string client = id_of(edge.client, edge.client, false);
    const bool is_spot = edge.provider.empty();
    const std::string provider = is_spot
                                     ? id_of("?" + port_text(edge.client, edge.client_port), edge.service + "?", true)
                                     : id_of(edge.provider, edge.provider + "?", true);
    text += notation.edge(provider, client, is_spot ? edge.client_port : edge_text(edge),
                          edge.trouble.empty() && edge.serves);
  }
  return text + notation.end;
}

}  // namespace

std::string text_graph(const control::System& system) {
  const auto edges = edges_of(system);
  std::string text;
  for (const auto* instance : FlowOrder(system, edges).take()) {
    text += fmt::format("{}{}  {}, {}\n", text.empty() ? "" : "\n", instance->name(),
                        short_name(instance->plugin().substr(instance->plugin().find('/') + 1)), instance->mode());
    for (const Edge& edge : edges) {
      if (edge.client != instance->name() || edge.client_port.empty()) continue;
      const bool spot = edge.provider.empty();
      const std::string line =
          spot ? fmt::format("  {} ?- {}", edge.client_port, edge.service)
               : fmt::format("  {} <- {}", edge.client_port, port_text(edge.provider, edge.provider_port));
      text += with_label(line, spot || edge.trouble.empty() ? (edge.serves ? "" : "ready") : edge.trouble) + "\n";
    }
    for (const Edge& edge : edges) {
      if (edge.provider != instance->name()) continue;
      text += with_label(fmt::format("  {} -> {}", edge.provider_port, port_text(edge.client, edge.client_port)),
                         label_of(edge)) +
              "\n";
    }
  }
  return text;
}

std::string dot_graph(const control::System& system) {
  return drawn(system, {"digraph fiona {\n  rankdir=LR;\n  node [shape=box];\n", "}\n",
                        [](const std::string& id, const std::string& label, bool spot) {
                          return fmt::format("  {} [label={}{}];\n", id, dot_quoted(label),
                                             spot ? ", style=dotted" : "");
                        },
                        [](const std::string& from, const std::string& to, const std::string& label, bool works) {
                          return fmt::format("  {} -> {} [label={}{}];\n", from, to, dot_quoted(label),
                                             works ? "" : ", style=dashed");
                        }});
}

std::string mermaid_graph(const control::System& system) {
  return drawn(system,
               {"flowchart LR\n", "",
                [](const std::string& id, const std::string& label, bool spot) {
                  return fmt::format("  {}{}{}{}\n", id, spot ? "([" : "[", mermaid_quoted(label), spot ? "])" : "]");
                },
                [](const std::string& from, const std::string& to, const std::string& label, bool works) {
                  return fmt::format("  {} {}|{}| {}\n", from, works ? "-->" : "-.->", mermaid_quoted(label), to);
                }});
}

}  // namespace fiona::console
