#include "../completion.hpp"
#include "../living_names.hpp"
#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

/// What has been typed: one word that is the whole line, as the shells' scripts give it, or the words themselves.
std::string typed_text(const Line& line) {
  std::string typed;
  for (std::size_t i = 1; i < line.words.items.size(); ++i) {
    const WordLine::Item& item = line.words.items[i];
    typed += (i == 1 ? "" : " ") + (item.name ? item.name->text + "=" : "") + item.word.text;
  }
  return typed;
}

/// `--host main unload `: of that one.
void take_host(Session& session, const std::string& typed) {
  try {
    WordLine words = split_line(typed);
    const auto options = take_global_options(words).value_or(std::map<std::string, std::string>{});
    if (const auto host = options.find("--host"); host != options.end()) session.options.host = host->second;
    if (const auto at = options.find("--at"); at != options.end()) session.options.at = at->second;
  } catch (const Error&) {  // inside a quote
  }
}

/// A host that cannot be found or does not answer knows no names; what the grammar knows is still told.
void connect(Session& session) {
  try {
    session.host_if_running();
  } catch (const Error&) {
    session.disconnect();
  }
}

}  // namespace

void complete(Session& session, const Line& line) {
  const std::string typed = typed_text(line);
  take_host(session, typed);
  connect(session);
  LivingNames names(session);
  for (const std::string& candidate : console::complete(typed, names).candidates) {
    session.out.object({{"candidate", candidate}});
    session.out.text(candidate);
  }
}

}  // namespace fiona::console::verbs
