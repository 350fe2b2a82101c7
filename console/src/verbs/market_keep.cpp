// market init, publish and accept: how packages come into a marketplace.
#include "market_keep.hpp"

#include <algorithm>
#include <map>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/marketplace/keeper.hpp>
#include <fiona/marketplace/open.hpp>

#include "market.hpp"

namespace fiona::console::verbs {
namespace {

namespace filesystem = std::filesystem;

void tell_accepted(Session& session, const marketplace::Accepted& accepted, const std::string& market) {
  for (const std::string& package : accepted.packages) {
    session.out.done(fmt::format("accepted {}", package), {{"package", package}});
  }
  for (const auto& one : accepted.refused)
    session.out.remark(fmt::format("refused {}: {}\n  next: {}", one.file, one.what, one.next));
  for (const auto& publisher : accepted.unknown) {
    session.out.remark(
        fmt::format("{} is {}; his key is {}\n  next: make sure that it is his, then: fiona market accept {} {} {}",
                    publisher.name, publisher.other_key ? "known by another key" : "a new publisher", publisher.key,
                    market, publisher.name, publisher.key));
  }
  for (const auto& role : accepted.ending)
    session.out.remark(fmt::format("what {} has signed {} on {}\n  next: {}", role.name,
                                   role.has_ended ? "ended" : "ends", role.until, role.next));
  if (accepted.packages.empty()) session.out.done("nothing new was accepted; index and time are signed anew");
}

}  // namespace

void market_init(Session& session, const Line& line) {
  filesystem::path market = filesystem::absolute(line.positional[1].text).lexically_normal();
  if (!market.has_filename()) market = market.parent_path();
  const marketplace::NewMarket made = marketplace::init_market(market);
  marketplace::trust_marketplace(made.root, market.string());
  session.out.done(fmt::format("made the marketplace {}", market.string()), {{"marketplace", market.string()}});
  session.out.remark(fmt::format("its users trust it by {}: fiona keys trust 1.root.json --from PLACE",
                                 (market / "metadata/1.root.json").string()));
  session.out.remark(fmt::format("its keys are in {}; keep copies of {}.root and {}.targets elsewhere",
                                 tuf::SigningKeys().path().string(), made.keys, made.keys));
}

void market_publish(Session& session, const Line& line) {
  const Word* to = line.option("--to");
  const std::string market = to == nullptr ? marketplace::Marketplace::default_directory().string() : to->text;
  const tuf::SigningKeys keys;
  const std::vector<std::string> own = keys.names();
  std::set<std::string> handed_in;
  std::vector<marketplace::Welcome> welcome;  // whose key is this user's, if he is the keeper too
  for (std::size_t i = 1; i < line.positional.size(); ++i) {
    const auto [publisher, file] = marketplace::submit(line.positional[i].text, market);
    handed_in.insert({publisher + ".json", file});
    if (std::find(own.begin(), own.end(), publisher) != own.end())
      welcome.push_back({publisher, keys.get(publisher).open()});
    session.out.done(fmt::format("handed in {}", line.positional[i].text), {{"file", line.positional[i].text}});
  }
  if (!marketplace::keeps(market)) return session.out.remark("it will be there once its keeper accepts it");
  marketplace::Accepted accepted = marketplace::accept(market, welcome);
  const auto is_own = [&handed_in](const marketplace::Refusal& one) { return handed_in.contains(one.file); };
  const auto refused = std::find_if(accepted.refused.begin(), accepted.refused.end(), is_own);
  if (refused == accepted.refused.end()) return tell_accepted(session, accepted, market);
  const marketplace::Refusal told = *refused;
  accepted.refused.erase(refused);
  tell_accepted(session, accepted, market);
  throw Error(ErrorCode::NotAllowed, {.what = "it was refused: " + told.what,
                                      .where = (filesystem::path(market) / "incoming" / told.file).string(),
                                      .next = told.next});
}

namespace {

struct NamedPublisher {
  Word name;
  tuf::OpenKey key;  ///< empty: it was not typed
};

/// Of "NAME [KEY] …".
std::vector<NamedPublisher> named_publishers(const Line& line) {
  std::vector<NamedPublisher> named;
  for (std::size_t i = 2; i < line.positional.size(); ++i) {
    const Word& word = line.positional[i];
    if (tuf::is_open_key(word.text) && !named.empty() && named.back().key.empty()) {
      named.back().key = word.text;
    } else if (marketplace::is_publisher(word.text)) {
      named.push_back({word, ""});
    } else {
      throw line.error(word, {.what = fmt::format("'{}' is neither a publisher nor a key", word.text),
                              .expected = "a key of 64 digits behind its publisher's name"});
    }
  }
  return named;
}

/// A name alone says nothing: whoever can hand in may have made a key of that name.
bool is_his_key(Session& session, const Line& line, const NamedPublisher& named,
                const marketplace::NewPublisher& publisher) {
  if (!named.key.empty())
    throw line.error(named.name,
                     {.what = fmt::format("{} has signed with another key than this", publisher.name),
                      .expected = named.key,
                      .found = publisher.key,
                      .next = "ask the publisher for his: fiona keys shows it to him"},
                     ErrorCode::BadSignature);
  const std::string question = fmt::format("Is {} the key of {}? (yes/no) ", publisher.key, publisher.name);
  const std::optional<bool> answer = session.ask ? session.ask(question) : std::nullopt;
  if (answer) return *answer;
  throw line.error(named.name,
                   {.what = "whoever has that key is this publisher from now on, and nobody is here to agree",
                    .next = fmt::format("make sure that it is his, then: fiona market accept {} {} {}",
                                        line.positional[1].text, publisher.name, publisher.key)},
                   ErrorCode::NotAllowed);
}

}  // namespace

void market_accept(Session& session, const Line& line) {
  const std::string& market = line.positional[1].text;
  const auto named = named_publishers(line);
  std::vector<marketplace::Welcome> welcome;
  for (const auto& one : named) welcome.push_back({one.name.text, one.key});
  marketplace::Accepted accepted = marketplace::accept(market, welcome);
  tell_accepted(session, accepted, market);
  welcome.clear();
  for (const auto& publisher : accepted.unknown) {
    const auto is_he = [&](const NamedPublisher& one) { return one.name.text == publisher.name; };
    const auto found = std::find_if(named.begin(), named.end(), is_he);
    if (found != named.end() && is_his_key(session, line, *found, publisher))
      welcome.push_back({publisher.name, publisher.key});
  }
  if (!welcome.empty()) {
    accepted = marketplace::accept(market, welcome);
    tell_accepted(session, accepted, market);
  }
  for (const auto& role : accepted.ending) {
    if (role.has_ended)
      throw Error(ErrorCode::Failed,
                  {.what = fmt::format("what {} has signed has ended, and nobody installs by it", role.name),
                   .where = market,
                   .found = "until " + role.until,
                   .next = role.next});
  }
}

void market_revoke(Session& session, const Line& line) {
  const Word* because = line.argument("because");
  const std::string& what = line.positional[2].text;
  const auto revoked = marketplace::revoke(line.positional[1].text, what, because == nullptr ? "" : because->text);
  for (const auto& one : revoked) {
    session.out.done(fmt::format("revoked {} {}", one.package(), one.version()),
                     {{"package", one.package()}, {"version", one.version()}});
  }
  if (what.find('/') == std::string::npos)
    session.out.done(fmt::format("{} is trusted no longer", what), {{"publisher", what}});
}

namespace {

/// Who signs what, by the names that this user has for keys.
void show_roles(Session& session, const std::vector<marketplace::MarketRole>& roles) {
  const tuf::SigningKeys own;
  std::map<std::string, std::string> names;
  for (const auto& name : own.names()) names[own.get(name).open()] = name;
  Table table({"role", "key", "here", "of", "until", "state"});
  table.leave_out_if_empty("state");
  const auto add = [&](const std::string& role, const tuf::Repository::RoleKeys& keys, const std::string& until,
                       const std::string& state) {
    for (const auto& key : keys.keys) {
      table.add({role, key, names.contains(key) ? names.at(key) : "",
                 fmt::format("{} of {}", keys.threshold, keys.keys.size()), until, state});
    }
  };
  for (const auto& role : roles) {
    add(role.name, role.keys, role.expires, "");
    if (role.proposed) add(role.name, *role.proposed, "", "proposed");
  }
  session.out.table(table, "it has no roles");
}

}  // namespace

void market_keys(Session& session, const Line& line) {
  show_roles(session, marketplace::market_roles(line.positional[1].text));
}

namespace {

void tell_root(Session& session, const marketplace::RootChange& change, const std::string& market) {
  for (const std::string& name : change.made)
    session.out.done(fmt::format("made the signing key {}", name), {{"key", name}});
  if (change.lacking == 0) return session.out.done("the marketplace has a new root; its users follow by themselves");
  session.out.done(
      fmt::format("a new root is proposed, and lacks {} signature{}", change.lacking, change.lacking == 1 ? "" : "s"),
      {{"lacking", change.lacking}});
  session.out.remark(fmt::format("each who has one of its keys: fiona market sign {}", market));
}

}  // namespace

void market_rotate(Session& session, const Line& line) {
  const std::string& market = line.positional[1].text;
  std::vector<std::string> keys;
  for (std::size_t i = 3; i < line.positional.size(); ++i) keys.push_back(line.positional[i].text);
  const Word* threshold = line.argument("threshold");
  const std::uint64_t wanted = threshold == nullptr ? 1 : count_of(*threshold, line.words);
  const auto change = marketplace::rotate(market, line.positional[2].text, keys, static_cast<std::int64_t>(wanted));
  tell_root(session, change, market);
}

void market_sign(Session& session, const Line& line) {
  const std::string& market = line.positional[1].text;
  const auto roles = marketplace::market_roles(market);
  if (!line.has("-y")) {
    show_roles(session, roles);
    require_yes(session, line, "Sign what is proposed?", "nothing was signed",
                {.what = "a root says who signs everything, and nobody is here to agree",
                 .next = "fiona market keys DIR shows it; then the same line with -y"});
  }
  tell_root(session, marketplace::sign_root(market, roles), market);
}

}  // namespace fiona::console::verbs
