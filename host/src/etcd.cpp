#include "etcd.hpp"

#include <sodium.h>

#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <cctype>
#include <charconv>
#include <nlohmann/json.hpp>

#include "fiona/error.hpp"
#include "fiona/readable_text.hpp"

namespace fiona::host {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = boost::beast::http;
using nlohmann::json;

/// A thousand hosts and more.
constexpr std::size_t kMostBytes = 1U << 20U;
constexpr std::size_t kMostTold = 200;

std::string in_base64(const std::string& bytes) {
  constexpr int kVariant = sodium_base64_VARIANT_ORIGINAL;
  std::string text(sodium_base64_encoded_len(bytes.size(), kVariant), '\0');
  sodium_bin2base64(text.data(), text.size(), reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(),
                    kVariant);
  text.pop_back();  // the null behind it
  return text;
}

/// As an error may have it.
std::string shown(std::string_view answer) {
  std::string text = readable_text(answer, kMostTold);
  std::replace_if(
      text.begin(), text.end(), [](unsigned char c) { return std::iscntrl(c) != 0; }, ' ');
  return text;
}

[[noreturn]] void refuse_answer(std::string_view answer) {
  throw Error(ErrorCode::Failed, {.what = "this is no answer of etcd",
                                  .found = shown(answer),
                                  .next = "see what listens there: curl URL/version; etcd 3.4 or later is needed"});
}

std::string from_base64(const json& given, std::string_view answer) {
  if (!given.is_string()) refuse_answer(answer);
  const auto& text = given.get_ref<const std::string&>();
  std::string bytes(text.size(), '\0');
  std::size_t size = 0;
  if (sodium_base642bin(reinterpret_cast<unsigned char*>(bytes.data()), bytes.size(), text.data(), text.size(), nullptr,
                        &size, nullptr, sodium_base64_VARIANT_ORIGINAL) != 0)
    refuse_answer(answer);
  bytes.resize(size);
  return bytes;
}

json parsed(std::string_view answer) {
  json all = json::parse(answer, nullptr, false);
  if (!all.is_object()) refuse_answer(answer);
  return all;
}

/// The gateway writes numbers of 64 bits as strings, and leaves out those that are 0.
std::int64_t number(const json& object, const char* name, std::string_view answer) {
  const auto found = object.find(name);
  if (found == object.end()) return 0;
  if (!found->is_string()) refuse_answer(answer);
  const auto& text = found->get_ref<const std::string&>();
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) refuse_answer(answer);
  return value;
}

std::vector<EtcdEntry> entries_of(const json& range, std::string_view answer) {
  std::vector<EtcdEntry> all;
  const auto found = range.find("kvs");
  if (found == range.end()) return all;
  if (!found->is_array()) refuse_answer(answer);
  for (const json& one : *found) {
    if (!one.is_object() || !one.contains("key")) refuse_answer(answer);
    all.push_back({from_base64(one["key"], answer), one.contains("value") ? from_base64(one["value"], answer) : "",
                   number(one, "mod_revision", answer), number(one, "lease", answer)});
  }
  return all;
}

json put(const std::string& key, const std::string& value, std::int64_t lease) {
  return {{"request_put", {{"key", in_base64(key)}, {"value", in_base64(value)}, {"lease", std::to_string(lease)}}}};
}

}  // namespace

std::int64_t etcd_answer::lease_granted(std::string_view answer) {
  const std::int64_t lease = number(parsed(answer), "ID", answer);
  if (lease == 0) refuse_answer(answer);
  return lease;
}

bool etcd_answer::lease_lives(std::string_view answer) {
  const json all = parsed(answer);
  const auto result = all.find("result");
  if (result == all.end() || !result->is_object()) refuse_answer(answer);
  return number(*result, "TTL", answer) > 0;
}

std::vector<EtcdEntry> etcd_answer::entries(std::string_view answer) { return entries_of(parsed(answer), answer); }

std::optional<std::vector<EtcdEntry>> etcd_answer::found_instead(std::string_view answer) {
  const json all = parsed(answer);
  const auto succeeded = all.find("succeeded");
  if (succeeded != all.end() && *succeeded == json(true)) return std::nullopt;
  const auto responses = all.find("responses");
  if (responses == all.end()) return std::vector<EtcdEntry>();
  if (!responses->is_array() || responses->empty() || !responses->front().is_object()) refuse_answer(answer);
  const auto range = responses->front().find("response_range");
  if (range == responses->front().end() || !range->is_object()) refuse_answer(answer);
  return entries_of(*range, answer);
}

Etcd::Etcd(const std::string& url) : url_(url) {
  constexpr std::string_view kScheme = "http://";
  std::string place = url.starts_with(kScheme) ? url.substr(kScheme.size()) : "";
  if (place.ends_with('/')) place.pop_back();
  const std::size_t colon = place.rfind(':');
  unsigned port = 0;
  if (colon != std::string::npos && colon > 0) {
    host_ = place.substr(0, colon);
    port_ = place.substr(colon + 1);
    const auto [end, error] = std::from_chars(port_.data(), port_.data() + port_.size(), port);
    if (error != std::errc() || end != port_.data() + port_.size() || port > 65'535) port = 0;
    if (host_.starts_with('[') && host_.ends_with(']')) host_ = host_.substr(1, host_.size() - 2);
  }
  if (port > 0 && host_.find_first_of("/@[] ") == std::string::npos) return;
  throw Error(ErrorCode::Usage,
              {.what = "this is no address of a registry",
               .expected = "http://HOST:PORT of an etcd; what it says is trusted for addresses, and not "
                           "for keys",
               .found = url});
}

std::int64_t Etcd::grant(std::chrono::seconds time) {
  return etcd_answer::lease_granted(ask("/v3/lease/grant", json{{"TTL", std::to_string(time.count())}}.dump()));
}

bool Etcd::keep_alive(std::int64_t lease) {
  return etcd_answer::lease_lives(ask("/v3/lease/keepalive", json{{"ID", std::to_string(lease)}}.dump()));
}

void Etcd::revoke(std::int64_t lease) { ask("/v3/lease/revoke", json{{"ID", std::to_string(lease)}}.dump()); }

std::optional<EtcdEntry> Etcd::put_first(const std::string& key, const std::string& value, std::int64_t lease) {
  const json nothing = {{"target", "CREATE"}, {"key", in_base64(key)}, {"create_revision", "0"}};
  const json look = {{"request_range", {{"key", in_base64(key)}}}};
  const auto found =
      etcd_answer::found_instead(ask("/v3/kv/txn", json{{"compare", json::array({nothing})},
                                                        {"success", json::array({put(key, value, lease)})},
                                                        {"failure", json::array({look})}}
                                                       .dump()));
  if (!found) return std::nullopt;
  return found->empty() ? EtcdEntry{key, "", 0, 0} : found->front();
}

bool Etcd::put_instead(const EtcdEntry& seen, const std::string& value, std::int64_t lease) {
  const json same = {{"target", "MOD"}, {"key", in_base64(seen.key)}, {"mod_revision", std::to_string(seen.changed)}};
  return !etcd_answer::found_instead(
      ask("/v3/kv/txn",
          json{{"compare", json::array({same})}, {"success", json::array({put(seen.key, value, lease)})}}.dump()));
}

std::vector<EtcdEntry> Etcd::all(const std::string& prefix) {
  std::string behind = prefix;
  ++behind.back();
  return etcd_answer::entries(
      ask("/v3/kv/range", json{{"key", in_base64(prefix)}, {"range_end", in_base64(behind)}}.dump()));
}

std::string Etcd::ask(const std::string& path, const std::string& body) {
  http::request<http::string_body> request{http::verb::post, path, 11};
  request.set(http::field::host, host_ + ":" + port_);
  request.set(http::field::content_type, "application/json");
  request.keep_alive(false);
  request.body() = body;
  request.prepare_payload();
  http::response_parser<http::string_body> answer;
  answer.body_limit(kMostBytes);
  beast::flat_buffer buffer;
  asio::io_context context(1);
  beast::tcp_stream stream(context);
  boost::system::error_code failure;
  const auto went_well = [&failure](const boost::system::error_code& error) { return !(failure = error); };
  const auto places = asio::ip::tcp::resolver(context).resolve(host_, port_, failure);
  if (!failure) {
    stream.expires_after(kPatience);
    stream.async_connect(places, [&](const auto& error, const auto&) {
      if (!went_well(error)) return;
      own_address_ = stream.socket().local_endpoint(failure).address().to_string();
      http::async_write(stream, request, [&](const auto& written, std::size_t) {
        if (went_well(written))
          http::async_read(stream, buffer, answer, [&](const auto& read, std::size_t) { went_well(read); });
      });
    });
    context.run();
  }
  if (failure) {
    throw Error(ErrorCode::Unreachable, {.what = "the registry at " + url_ + " does not answer",
                                         .found = failure.message(),
                                         .next = "see whether etcd runs there: curl " + url_ + "/health"});
  }
  if (answer.get().result() == http::status::ok) return std::move(answer.get().body());
  throw Error(ErrorCode::Failed, {.what = "the registry at " + url_ + " refuses " + path,
                                  .found = shown(answer.get().body()),
                                  .next = "see whether etcd is well there: curl " + url_ + "/health"});
}

}  // namespace fiona::host
