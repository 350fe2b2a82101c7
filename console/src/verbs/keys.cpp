// keys: the key pair of this user's hosts, and which other hosts may connect to them.
#include <fiona/trust/host_keys.hpp>

#include <fmt/format.h>

#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

void list(Session& session, const trust::KeyDirectory& keys) {
  Table table({"host", "key"});
  for (const auto& one : keys.allowed()) table.add({one.name, one.key.text()});
  session.out.table(table, "no other host may connect\n  next: keys allow NAME KEY");
  if (!keys.has_pair()) session.out.remark("this user's hosts have no key pair\n  next: keys make");
}

}  // namespace

void keys(Session& session, const Line& line) {
  const trust::KeyDirectory keys;
  const std::string what = line.positional.empty() ? "" : line.positional[0].text;
  if (what == "make") return session.out.done(fmt::format("made the key pair of this user's hosts; others are given {}", keys.make().open.text()));
  if (what == "show") return session.out.text(keys.pair().open.text());
  if (what == "allow") {
    keys.allow(line.positional[1].text, line.positional[2].text);
    return session.out.done(fmt::format("host {} may connect", line.positional[1].text));
  }
  if (what == "forget") {
    keys.forget(line.positional[1].text);
    return session.out.done(fmt::format("host {} may not connect any more", line.positional[1].text));
  }
  list(session, keys);
}

}  // namespace fiona::console::verbs
