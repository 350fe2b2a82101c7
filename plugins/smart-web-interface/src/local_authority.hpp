#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "fiona/records/record_store.hpp"

namespace fiona::smart_web_interface {

/// By what a server shows who it is. In PEM.
struct ServerProof {
  std::string certificate{};
  std::string key{};
};

/// A certificate authority of this system alone: pages on other devices know the server by it once they have been told
/// to trust it. It is made at the first need, is kept in the store, and may vouch for addresses only, never for names:
/// who steals its key is no bank's or shop's server (RFC 5280, section 4.2.1.10). ECDSA on P-256 with SHA-256.
class LocalAuthority {
 public:
  /// Devices judge certificates by the wall clock, whatever time the system that is looked at lives in.
  using Time = std::chrono::system_clock::time_point;

  /// Of the authority, from `now`.
  static constexpr auto kTime = std::chrono::hours(24 * 3650);
  /// Of a server: the most that browsers take from an authority that their user has added.
  static constexpr auto kServerTime = std::chrono::hours(24 * 825);

  /// Reads it from `store`, or makes it; one that ends before a server's certificate would is replaced. Throws Error
  /// (Failed) where what is kept is no authority, or begins later than now.
  LocalAuthority(records::RecordStore& store, Time now);
  ~LocalAuthority();
  LocalAuthority(const LocalAuthority&) = delete;
  LocalAuthority& operator=(const LocalAuthority&) = delete;

  /// It is another one than was kept: devices have to be paired again.
  bool is_replaced() const { return replaced_; }
  /// What devices are to trust, in PEM.
  std::string certificate() const;
  /// SHA-256 of it, as browsers show it: "3F:0A:…".
  std::string fingerprint() const;
  /// For the server at a numeric `address`, with a key that is new each time and is never written down.
  ServerProof prove(const std::string& address, Time now) const;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
  bool replaced_ = false;
};

}  // namespace fiona::smart_web_interface
