#pragma once

#include <string>

#include <fiona/marketplace/index.hpp>

#include "../session.hpp"

namespace fiona::console::verbs {

/// The one at this place, or the user's. Tells also what it has revoked of what is installed, and keeps that.
marketplace::Marketplace opened_market(Session& session, const std::string& place);
/// The same of the place that --from names, if it does.
marketplace::Marketplace chosen_market(Session& session, const Line& line);

/// What a right lets a package do, in words: "speaks to the network (network)".
std::string right_text(const std::string& right);

/// Asks who is here. Throws Error where they say no, which is told as `undone`, or where there is nobody.
void require_yes(Session& session, const Line& line, const std::string& question, const std::string& undone,
                 ErrorText nobody);

void market_search(Session& session, const Line& line);
void market_info(Session& session, const Line& line);

}  // namespace fiona::console::verbs
