// market init, publish and accept: how packages come into a marketplace.
#include "market_keep.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <fiona/marketplace/keeper.hpp>
#include <fiona/marketplace/open.hpp>

namespace fiona::console::verbs {
namespace {

namespace filesystem = std::filesystem;

void tell_accepted(Session& session, const marketplace::Accepted& accepted, const std::string& market) {
  for (const std::string& package : accepted.packages) {
    session.out.done(fmt::format("accepted {}", package), {{"package", package}});
  }
  for (const std::string& reason : accepted.refused) session.out.remark("refused " + reason);
  for (const auto& publisher : accepted.unknown) {
    session.out.remark(fmt::format(
        "{} is {}; his key is {}\n  next: make sure that it is his, then: fiona market accept {} {}", publisher.name,
        publisher.other_key ? "known by another key" : "a new publisher", publisher.key, market, publisher.name));
  }
  if (accepted.packages.empty()) session.out.done("nothing new was accepted; index and time are signed anew");
}

}  // namespace

void market_init(Session& session, const Line& line) {
  const filesystem::path market = filesystem::absolute(line.positional[1].text).lexically_normal();
  const std::string root = marketplace::init_market(market);
  marketplace::trust_marketplace(root, market.string());
  session.out.done(fmt::format("made the marketplace {}", market.string()), {{"marketplace", market.string()}});
  session.out.remark(fmt::format("its users trust it by {}: fiona keys trust 1.root.json --from PLACE",
                                 (market / "metadata/1.root.json").string()));
  session.out.remark(fmt::format("its keys are in {}; keep copies of NAME.root and NAME.targets elsewhere",
                                 tuf::SigningKeys().path().string()));
}

void market_publish(Session& session, const Line& line) {
  const Word* to = line.option("--to");
  const std::string market = to == nullptr ? marketplace::Marketplace::default_directory().string() : to->text;
  const std::vector<std::string> own = tuf::SigningKeys().names();
  std::vector<std::string> welcome;  // whose key is this user's, if he is the keeper too
  for (std::size_t i = 1; i < line.positional.size(); ++i) {
    const std::string publisher = marketplace::submit(line.positional[i].text, market);
    if (std::find(own.begin(), own.end(), publisher) != own.end()) welcome.push_back(publisher);
    session.out.done(fmt::format("handed in {}", line.positional[i].text), {{"file", line.positional[i].text}});
  }
  if (!marketplace::keeps(market)) return session.out.remark("it will be there once its keeper accepts it");
  tell_accepted(session, marketplace::accept(market, welcome), market);
}

void market_accept(Session& session, const Line& line) {
  std::vector<std::string> welcome;
  for (std::size_t i = 2; i < line.positional.size(); ++i) welcome.push_back(line.positional[i].text);
  tell_accepted(session, marketplace::accept(line.positional[1].text, welcome), line.positional[1].text);
}

}  // namespace fiona::console::verbs
