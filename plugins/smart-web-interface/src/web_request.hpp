#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

namespace fiona::smart_web_interface {

/// What of an HTTP request this server looks at.
struct WebRequest {
  std::string method{};
  std::string target{};
  std::string host{};
  std::string origin{};
  std::string fetch_site{};  ///< Sec-Fetch-Site: who caused it, as the browser says
  std::string content_type{};
  std::string authorization{};
  std::string body{};
};

/// Bounds of a request, in bytes.
inline constexpr std::size_t kMaxHeader = 8 * 1024;
inline constexpr std::size_t kMaxBody = 64 * 1024;

/// Reads a whole request. Nothing for bytes that are none within the bounds. For tests; the server reads piece by
/// piece.
std::optional<WebRequest> parse_request(std::string_view bytes);

/// A number and a sentence that the page can show.
struct Refusal {
  int status = 400;
  std::string text{};
};

/// The session of a page and what it asks for: "map", "login" …
struct ApiCall {
  std::string name{};
  std::string bearer{};  ///< empty for "session" alone, which exchanges a link's token
  std::string body{};
};

struct AssetRequest {
  std::string name{};  ///< of the file
  bool head = false;
};

using Route = std::variant<AssetRequest, ApiCall, Refusal>;

/// What is served: files by path, and under which names this server may be spoken to.
struct Site {
  std::map<std::string, std::string, std::less<>> files;  ///< path to file name
  std::vector<std::string> hosts;                         ///< "127.0.0.1:8080"
  std::string scheme = "http://";
};

/// Decides what a request is, and refuses what a page of another origin can send: another Host (DNS rebinding), another
/// or no Origin, another content type than a form's can be, no session.
Route route(const WebRequest& request, const Site& site);

}  // namespace fiona::smart_web_interface
