// keys: the key pair of this user's hosts and consoles, which others may connect, and which are known by a name; what
// signs packages; which marketplaces are trusted.
#include <fiona/marketplace/keeper.hpp>
#include <fiona/marketplace/open.hpp>
#include <fiona/trust/host_keys.hpp>
#include <fiona/trust/signing_key.hpp>

#include <fstream>

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
  if (!keys.has_pair())
    session.out.remark("this user's hosts and consoles have no key pair for others to know them by\n  next: keys make");
}

void list_signing(Session& session) {
  const tuf::SigningKeys signing;
  Table keys({"signs", "key"});
  for (const auto& name : signing.names()) keys.add({name, signing.get(name).open()});
  if (!signing.names().empty()) session.out.table(keys, "");
  const auto places = marketplace::trusted_marketplaces();
  Table trusted({"marketplace", "root key", "root expires"});
  for (const auto& place : places) {
    for (const auto& key : place.root_keys) trusted.add({place.location, key, place.expires});
  }
  if (!places.empty()) session.out.table(trusted, "");
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

std::string root_in(const Line& line) {
  std::ifstream file(line.positional[1].text, std::ios::binary);
  if (file) return {std::istreambuf_iterator<char>(file), {}};
  throw line.error(line.positional[1],
                   {.what = "the file cannot be read", .expected = "a root.json that came by a way you trust"},
                   ErrorCode::NotFound);
}

void trust_root(Session& session, const Line& line) {
  const Word* from = line.option("--from");
  const std::string place = from == nullptr ? "" : from->text;
  marketplace::trust_marketplace(root_in(line), place);
  session.out.done(fmt::format("the marketplace {} is trusted",
                               place.empty() ? marketplace::Marketplace::default_directory().string() : place));
}

}  // namespace

void keys(Session& session, const Line& line) {
  const trust::KeyDirectory keys;
  const std::string what = line.positional.empty() ? "" : line.positional[0].text;
  if (what == "make")
    return session.out.done(fmt::format("made the key pair of this user's hosts and consoles; others are given {}",
                                        keys.make().open.text()));
  if (what == "show") {
    const std::string key = keys.pair().open.text();
    return session.out.manner.json ? session.out.done(key, {{"key", key}}) : session.out.text(key);
  }
  if (what == "allow") return allow(session, keys, line);
  if (what == "know") {
    keys.know(line.positional[1].text, line.positional[2].text, line.positional[3].text);
    return session.out.done(
        fmt::format("fiona --at {} speaks to {}", line.positional[1].text, line.positional[2].text));
  }
  if (what == "new") {
    const tuf::SigningKey key = tuf::SigningKeys().make(line.positional[1].text);
    return session.out.done(fmt::format("made the signing key {}: {}", line.positional[1].text, key.open()));
  }
  if (what == "renew") {
    const tuf::OpenKey key = marketplace::renew_key(line.positional[1].text);
    session.out.done(fmt::format("{} signs with another key from now on: {}", line.positional[1].text, key));
    return session.out.remark(
        "next: tell it to the keeper of each marketplace, who is to welcome you again: plugin sign, "
        "market publish; then market accept DIR NAME KEY");
  }
  if (what == "trust") return trust_root(session, line);
  if (what == "forget") {
    keys.forget(line.positional[1].text);
    return session.out.done(fmt::format("{} may not connect any more, and is not known", line.positional[1].text));
  }
  list(session, keys);
  list_signing(session);
}

}  // namespace fiona::console::verbs
