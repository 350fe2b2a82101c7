#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::host {

/// A key of etcd, and what is there.
struct EtcdEntry {
  std::string key;
  std::string value;
  std::int64_t changed = 0;  ///< revision of the store in which it was put last: each put has a greater one
  std::int64_t lease = 0;    ///< it goes with this one; 0: it stays
};

/// What etcd's gateway answers, JSON (etcd 3.4, api/v3). Throws Error Failed for anything else.
namespace etcd_answer {
std::int64_t lease_granted(std::string_view answer);
/// Whether the lease is there still.
bool lease_lives(std::string_view answer);
std::vector<EtcdEntry> entries(std::string_view answer);
/// Of a transaction that did not fit: what was there instead. Nothing: it was made.
std::optional<std::vector<EtcdEntry>> found_instead(std::string_view answer);
}  // namespace etcd_answer

/// A client of etcd's JSON gateway. Each request is a connection of its own and ends within `kPatience`, once the name
/// of its host is resolved. All throw Error: Unreachable without an answer, Failed for one that is no success or no
/// answer of etcd.
class Etcd {
 public:
  static constexpr std::chrono::milliseconds kPatience{1000};

  /// "http://HOST:PORT". Throws Error Usage.
  explicit Etcd(const std::string& url);

  std::int64_t grant(std::chrono::seconds time);
  /// False: it has ended.
  bool keep_alive(std::int64_t lease);
  void revoke(std::int64_t lease);
  /// Where nothing is. Otherwise what is there, and nothing is put.
  std::optional<EtcdEntry> put_first(const std::string& key, const std::string& value, std::int64_t lease);
  /// In the place of `seen`. False: something else is there by now.
  bool put_instead(const EtcdEntry& seen, const std::string& value, std::int64_t lease);
  /// Those whose keys begin so.
  std::vector<EtcdEntry> all(const std::string& prefix);

  const std::string& url() const { return url_; }
  /// The address of this machine that the last request went out from.
  const std::string& own_address() const { return own_address_; }

 private:
  std::string ask(const std::string& path, const std::string& body);

  const std::string url_;
  std::string host_;
  std::string port_;
  std::string own_address_;
};

}  // namespace fiona::host
