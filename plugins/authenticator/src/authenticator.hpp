#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "accounts.hpp"
#include "fiona/authenticator/params.pb.h"
#include "fiona/component.hpp"
#include "fiona/hull.hpp"
#include "fiona/security.fiona.hpp"
#include "login_desk.hpp"
#include "sessions.hpp"
#include "throttle.hpp"

namespace fiona::authenticator {

/// Checks names and passwords, and says whose a session is.
class Authenticator : public Component {
 public:
  /// A virtual clock waits for strands alone: there the strand itself hashes, and time stands meanwhile.
  explicit Authenticator(Hull& hull) : Authenticator(hull, hull.clock().staging()) {}

 protected:
  Authenticator(Hull& hull, bool hashes_itself) : Component(hull), hashes_itself_(hashes_itself) {}

 private:
  using Parameters = authenticator::Parameters;
  using LoginReply = Reply<security::CommAuthenticationResponse>;

  void on_start() override;
  void on_stop() override;
  void check(const Parameters& draft) const;

  void on_login(const security::CommAuthenticationRequest& request, LoginReply reply);
  security::CommSession on_session(const security::CommSessionRequest& request);
  security::CommLogoutResponse on_logout(const security::CommSessionRequest& request);
  void look();

  security::CommAuthenticationResponse checked(const LoginDesk::Attempt& attempt, const Sessions::Bounds& bounds,
                                               const Throttle::Rule& rule);
  const Account* account_of(const Session& session) const;
  void read_accounts();
  void read_changes();
  void tell(const Error& trouble);

  Params<Parameters> params_{*this, &Authenticator::check};
  Provides<security::AuthenticationProvider> login_{
      *this, "login", &Authenticator::on_login, {.doc = "checks a name and a password, and begins a session"}};
  Provides<security::SessionProvider> sessions_port_{*this, "sessions", &Authenticator::on_session};
  Provides<security::LogoutProvider> logout_{*this, "logout", &Authenticator::on_logout};
  Probe<std::uint64_t> session_count_{*this, "sessions_open", {.doc = "sessions that stand for a user now"}};
  Probe<std::uint64_t> failed_{*this, "failed_logins", {.doc = "names and passwords that did not fit"}};
  Probe<std::uint64_t> refused_{*this, "refused_logins", {.doc = "attempts that came too soon, or too many at once"}};
  Task look_{*this, "look", std::chrono::milliseconds(500), &Authenticator::look};

  const bool hashes_itself_;
  std::unique_ptr<records::RecordStore> store_;
  std::unique_ptr<Accounts> accounts_;
  std::unique_ptr<Sessions> sessions_;
  std::map<std::string, Account> known_;  ///< accounts as they were at `version_`
  std::optional<std::uint64_t> version_;  ///< none: they could not be read when they were looked at last
  std::string trouble_;                   ///< with the database, as it was told
  std::uint64_t refusals_ = 0;
  std::atomic<std::uint64_t> failures_{0};
  std::mutex throttle_mutex_;
  Throttle throttle_;
  std::unique_ptr<LoginDesk> desk_;
};

}  // namespace fiona::authenticator
