#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "etcd.hpp"
#include "fiona/error.hpp"
#include "fiona/trust/host_keys.hpp"

namespace fiona::host {

/// What hosts on several machines share: who there is, and where. Each holds its name by a lease that it renews, so
/// that the entry of one that has died goes with it; while it is held no other host may have it. Only another run of
/// the same host, which has the same key, takes its place at once. A registry that is away changes nothing between
/// hosts that know each other. It says where a host is; that it is this one, the keys say
/// (docs/decisions/0037-a-registry-says-where.md).
class Registry {
 public:
  using OnLog = std::function<void(const std::string&)>;
  static constexpr std::chrono::seconds kLease{5};
  static constexpr std::chrono::seconds kLookEvery{1};

  struct Host {
    std::string address;  ///< "HOST:PORT"; empty: it listens at none
    trust::Key key;
    std::int64_t incarnation = 0;  ///< greater for each run that has held the name
    bool operator==(const Host&) const = default;
  };
  /// Nothing where others have put something else under that name.
  static std::optional<Host> host_in(const EtcdEntry& entry);

  /// Takes `name`; where the registry does not answer, once it does. `listens`: "tcp://HOST:PORT", or empty; of one
  /// that stands for all addresses the one towards the registry is told. Throws Error: NotAllowed while another host
  /// has the name, Usage for a URL that is none.
  Registry(const std::string& url, std::string name, const std::string& listens, const trust::Key& key, OnLog on_log);
  ~Registry();

  /// [any thread] "tcp://HOST:PORT" of the host that has this name and key. Throws Error that says why there is none.
  std::string address_of(const std::string& name, const trust::Key& key) const;
  /// [any thread] As of the last look that went well.
  std::map<std::string, Host> hosts() const;

 private:
  void serve();
  /// Why it was in vain; NotAllowed: only in that the name is another's.
  std::optional<Error> look();
  void read_and_hold();
  void tell(const std::optional<Error>& problem);
  void hold();
  std::string told_address() const;

  Etcd etcd_;
  const std::string name_;
  const std::string listens_;
  const trust::Key key_;
  const OnLog on_log_;
  std::int64_t lease_ = 0;  ///< 0: the name is not held
  bool replaced_ = false;   ///< another run of this host has the name
  std::string trouble_;     ///< as it was told; empty: none
  mutable std::mutex mutex_;
  std::condition_variable ends_;
  bool stopping_ = false;
  std::map<std::string, Host> hosts_;
  std::optional<Error> problem_;  ///< why what is known may be old
  std::thread thread_;
};

}  // namespace fiona::host
