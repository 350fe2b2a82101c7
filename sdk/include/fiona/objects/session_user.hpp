#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <utility>

#include "fiona/async.hpp"
#include "fiona/error.hpp"
#include "fiona/query.hpp"
#include "fiona/security.fiona.hpp"

/// Who a request is from that carries a user's name and a session (decided at CommAuthenticationResponse in
/// security.proto).
namespace fiona::security {

struct SessionUser {
  std::string name;  ///< empty: the guest
  int level = 0;     ///< 0 to 9
};

/// The guest without name and session; nobody where the session has ended. Throws Error NotAllowed where a name comes
/// without a session, where the session is another user's, and where it could not be checked. [strand of the port]
inline Async<std::optional<SessionUser>> session_user(Requires<SessionProvider>& sessions, std::string name,
                                                      std::string session) {
  constexpr auto kDeadline = std::chrono::milliseconds(500);
  if (name.empty() && session.empty()) co_return SessionUser{};
  if (session.empty()) {
    throw Error(ErrorCode::NotAllowed, {.what = "the request names a user and carries no session",
                                        .where = sessions.full_name(),
                                        .next = "log in, or leave user_name out to be a guest"});
  }
  CommSessionRequest request;
  request.set_session(std::move(session));
  const auto found = co_await sessions.query(std::move(request), kDeadline);
  if (!found) {
    throw Error(ErrorCode::NotAllowed,
                {.what = "the session could not be checked: " + std::string(to_string(found.outcome())) +
                         (found.reason().empty() ? "" : ", " + found.reason()),
                 .where = sessions.full_name(),
                 .next = "try again, or leave user_name and session out to be a guest"});
  }
  if (!(*found)->is_valid()) co_return std::nullopt;
  if ((*found)->user_name() != name) {
    throw Error(ErrorCode::NotAllowed, {.what = "the session is another user's",
                                        .where = sessions.full_name(),
                                        .next = "name the user as the answer to the login did"});
  }
  co_return SessionUser{std::move(name), (*found)->authentication_level()};
}

/// What a request is refused with whose session has ended, where the reply cannot say so.
inline Error session_ended(const std::string& where) {
  return Error(ErrorCode::NotAllowed, {.what = "there is no such session, or it has ended",
                                       .where = where,
                                       .next = "log in again, or leave user_name and session out to be a guest"});
}

}  // namespace fiona::security
