#pragma once

#include <string_view>

#include "links.hpp"

namespace fiona::host {

// How a host that leads names processes to one that it leads: it knows no sockets of that.
inline constexpr std::string_view kLeaderEndpoint = Links::kHost;  ///< the leader, and whoever is reached through it
inline constexpr std::string_view kGroupEndpoint = "group:";       ///< before a group's name on its own host

/// `message`: of a wire that is opened towards there.
template <class WireMessage>
void set_endpoint(WireMessage& message, const Links::Endpoint& to) {
  message.set_endpoint(to.address);
  message.set_name(to.name);
  message.set_key(to.key);
}

}  // namespace fiona::host
