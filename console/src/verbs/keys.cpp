// keys: the key pair of this user's hosts and consoles, which others may connect, and which are known by a name.
#include <fiona/trust/host_keys.hpp>

#include <fmt/format.h>

#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

void list(Session& session, const trust::KeyDirectory& keys) {
  Table table({"host", "key", "as", "at"});
  for (const auto& one : keys.allowed()) table.add({one.name, one.key.text(), "host", ""});
  for (const auto& one : keys.consoles()) table.add({one.name, one.key.text(), trust::access_name(one.level), ""});
  for (const auto& one : keys.known()) table.add({one.name, one.key.text(), "known", one.address});
  session.out.table(table, "no other host or console may connect\n  next: keys allow NAME KEY");
  if (!keys.has_pair()) session.out.remark("this user has no key pair\n  next: keys make");
}

void allow(Session& session, const trust::KeyDirectory& keys, const Line& line) {
  const std::string& name = line.positional[1].text;
  const Word* as = line.clause("as");
  if (as == nullptr) {
    keys.allow(name, line.positional[2].text);
    return session.out.done(fmt::format("host {} may connect", name));
  }
  keys.allow_console(name, line.positional[2].text, *trust::access_of(as->text));
  session.out.done(fmt::format("console {} may connect, and {}", name, as->text));
}

}  // namespace

void keys(Session& session, const Line& line) {
  const trust::KeyDirectory keys;
  const std::string what = line.positional.empty() ? "" : line.positional[0].text;
  if (what == "make")
    return session.out.done(fmt::format("made the key pair of this user's hosts and consoles; others are given {}",
                                        keys.make().open.text()));
  if (what == "show") return session.out.text(keys.pair().open.text());
  if (what == "allow") return allow(session, keys, line);
  if (what == "know") {
    keys.know(line.positional[1].text, line.positional[2].text, line.positional[3].text);
    return session.out.done(
        fmt::format("fiona --at {} speaks to {}", line.positional[1].text, line.positional[2].text));
  }
  if (what == "forget") {
    keys.forget(line.positional[1].text);
    return session.out.done(fmt::format("{} may not connect any more, and is not known", line.positional[1].text));
  }
  list(session, keys);
}

}  // namespace fiona::console::verbs
