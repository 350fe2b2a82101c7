#pragma once

#include "../session.hpp"

namespace fiona::console::verbs {

// The keeper's and the publisher's side of `market`.
void market_init(Session& session, const Line& line);
void market_publish(Session& session, const Line& line);
void market_accept(Session& session, const Line& line);
void market_revoke(Session& session, const Line& line);
void market_keys(Session& session, const Line& line);
void market_rotate(Session& session, const Line& line);
void market_sign(Session& session, const Line& line);

}  // namespace fiona::console::verbs
