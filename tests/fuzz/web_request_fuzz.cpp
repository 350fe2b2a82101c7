// The bytes of an HTTP request: whatever they are, they are refused or decided on within bounds; and nothing but a
// request of the page itself becomes a call, whose body is then read or refused in words.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "page_calls.hpp"
#include "web_request.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace fiona::smart_web_interface;
  static const Site site{{{"/", "index.html"}, {"/page.js", "page.js"}}, {"127.0.0.1:8080", "localhost:8080"}};
  const auto request = parse_request({reinterpret_cast<const char*>(data), size});
  if (!request) return 0;
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
    const auto read = read_call(call);
    if (const auto* fault = std::get_if<Refusal>(&read); fault && fault->text.empty()) std::abort();
    if (const auto* points = std::get_if<PageCall>(&read)) {
      const auto* set = std::get_if<SetPoints>(points);
      if (set && set->points.size() > 256) std::abort();
    }
  }
  return 0;
}
