// The bytes of an HTTP request: whatever they are, they are refused or decided on within bounds; and nothing but a
// request of the page itself becomes a call, whose body is then read or refused in words. As a body alone they are of
// each call, so that what reads it is reached without a length that fits.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "page_calls.hpp"
#include "web_request.hpp"

namespace {

using namespace fiona::smart_web_interface;

void check_call(ApiCall& call) {
  const auto read = read_call(call);
  if (const auto* fault = std::get_if<Refusal>(&read)) {
    if (fault->text.empty()) std::abort();
    return;
  }
  const auto& known = std::get<PageCall>(read);
  const auto* set = std::get_if<SetPoints>(&known);
  if (level_of(known) < 0 || (set && set->points.size() > 256)) std::abort();
}

void check_request(std::string_view bytes) {
  static const Site site{{{"/", "index.html"}, {"/page.js", "page.js"}}, {"127.0.0.1:8080", "localhost:8080"}};
  const auto request = parse_request(bytes);
  if (!request) return;
  if (request->body.size() > kMaxBody || request->target.size() > kMaxHeader) std::abort();
  Route decided = route(*request, site);
  if (const auto* refusal = std::get_if<Refusal>(&decided)) {
    if (refusal->text.empty() || refusal->status < 400) std::abort();
  } else if (const auto* asset = std::get_if<AssetRequest>(&decided)) {
    if (asset->name != "index.html" && asset->name != "page.js") std::abort();
  } else {
    auto& call = std::get<ApiCall>(decided);
    if (request->origin != "http://127.0.0.1:8080" && request->origin != "http://localhost:8080") std::abort();
    if (call.bearer.empty() && call.name != "session" && request->authorization != "Bearer ") std::abort();
    check_call(call);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes{reinterpret_cast<const char*>(data), size};
  check_request(bytes);
  for (const char* name : {"session", "login", "profile", "points", "destination", "rewire"}) {
    ApiCall call{.name = name, .body = std::string(bytes)};
    check_call(call);
  }
  return 0;
}
