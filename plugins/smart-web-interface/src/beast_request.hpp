#pragma once

#include <utility>

#include <boost/beast/http.hpp>

#include "web_request.hpp"

namespace fiona::smart_web_interface {

using RequestParser = boost::beast::http::request_parser<boost::beast::http::string_body>;

inline void set_bounds(RequestParser& parser) {
  parser.header_limit(kMaxHeader);
  parser.body_limit(kMaxBody);
}

inline WebRequest request_of(boost::beast::http::request<boost::beast::http::string_body>&& message) {
  namespace http = boost::beast::http;
  // Two of one name are none: which of them counts is what smuggling lives on.
  const auto field = [&message](auto name) {
    const auto [first, last] = message.equal_range(name);
    if (first == last || std::next(first) != last) return std::string();
    return std::string(first->value());
  };
  WebRequest request{.method = std::string(message.method_string()),
                     .target = std::string(message.target()),
                     .host = field(http::field::host),
                     .origin = field(http::field::origin),
                     .fetch_site = field("Sec-Fetch-Site"),
                     .content_type = field(http::field::content_type),
                     .authorization = field(http::field::authorization)};
  request.body = std::move(message.body());
  return request;
}

}  // namespace fiona::smart_web_interface
