#include "web_request.hpp"

#include <algorithm>

#include "beast_request.hpp"

namespace fiona::smart_web_interface {
namespace {

constexpr std::string_view kApi = "/api/";
constexpr std::string_view kBearer = "Bearer ";
constexpr std::string_view kCalls[] = {"session", "events", "map",         "me",     "login", "logout",
                                       "profile", "points", "destination", "system", "rewire"};

Route api_call(const WebRequest& request, const Site& site) {
  const std::string name = request.target.substr(kApi.size());
  if (std::find(std::begin(kCalls), std::end(kCalls), name) == std::end(kCalls)) {
    return Refusal{404, "there is nothing at this address"};
  }
  if (request.method != "POST") return Refusal{405, "this address takes POST only"};
  if (request.origin != site.scheme + request.host) return Refusal{403, "the request comes from another page"};
  if (!request.fetch_site.empty() && request.fetch_site != "same-origin") {
    return Refusal{403, "the request comes from another page"};
  }
  if (request.content_type != "application/json") return Refusal{415, "this address takes application/json only"};
  ApiCall call{.name = name, .body = request.body};
  if (name == "session") return call;
  if (!request.authorization.starts_with(kBearer))
    return Refusal{401, "the page has no session: open it with a new link"};
  call.bearer = request.authorization.substr(kBearer.size());
  return call;
}

}  // namespace

std::optional<WebRequest> parse_request(std::string_view bytes) {
  RequestParser parser;
  set_bounds(parser);
  parser.eager(true);
  boost::beast::error_code fault;
  while (!bytes.empty() && !parser.is_done()) {
    const std::size_t used = parser.put(boost::asio::buffer(bytes.data(), bytes.size()), fault);
    if (fault || used == 0) return std::nullopt;
    bytes.remove_prefix(used);
  }
  if (!parser.is_done()) return std::nullopt;
  return request_of(parser.release());
}

Route route(const WebRequest& request, const Site& site) {
  // First of all: a foreign name that leads here is a page that another site has made.
  if (std::find(site.hosts.begin(), site.hosts.end(), request.host) == site.hosts.end()) {
    return Refusal{421, "this server is not called by that name"};
  }
  if (request.target.starts_with(kApi)) return api_call(request, site);
  if (request.method != "GET" && request.method != "HEAD") return Refusal{405, "this address takes GET only"};
  const auto file = site.files.find(request.target);
  if (file == site.files.end()) return Refusal{404, "there is nothing at this address"};
  return AssetRequest{file->second, request.method == "HEAD"};
}

}  // namespace fiona::smart_web_interface
