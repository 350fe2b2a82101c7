#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "fiona/records/record_store.hpp"
#include "fiona/smart_web_interface/params.pb.h"
#include "fiona/time.hpp"

namespace fiona::smart_web_interface {

/// Who may use the page: tokens, each of which opens one session, and sessions, each a number of 256 bits that only its
/// page has. Hashes are kept of both, and of sessions in the database too, so that pages go on after a restart; who is
/// logged in on a page is sealed with a key made of the page's number (XSalsa20-Poly1305), which is of no use to
/// whoever reads the file. All functions [any thread].
class PageSessions {
 public:
  static constexpr std::size_t kMaxTokens = 16;
  static constexpr std::size_t kMaxSessions = 64;
  static constexpr auto kTokenTime = std::chrono::minutes(10);

  /// One of the database that would go on for longer goes on for `time`: the clock, or `time`, was another one.
  PageSessions(records::RecordStore& store, TimePoint now, Duration time);

  /// 128 bits in hexadecimal digits. One too many ends the oldest.
  std::string make_token(TimePoint now);
  /// A session for a token, which is used up; nothing for one that is none. `number`: the page's own, random; with it
  /// the token gives the same session again until its time is over, for the first answer may have been lost.
  std::optional<std::string> open(const std::string& token, const std::string& number, TimePoint now, Duration time);
  bool is_open(const std::string& session, TimePoint now) const;
  /// Who is logged in on the page; nothing: the guest.
  std::optional<PageUser> user(const std::string& session, TimePoint now) const;
  /// False: there is no such session.
  bool set_user(const std::string& session, const std::optional<PageUser>& user, TimePoint now);

 private:
  struct Token {
    TimePoint end;
    std::string opened;  ///< hash of its session; empty: it is not used yet
  };

  const PageSession* find(const std::string& session, TimePoint now) const;
  void forget_expired(TimePoint now);

  records::RecordStore& store_;
  mutable std::mutex mutex_;
  const std::string key_;                        ///< without which no session follows from token and number
  std::map<std::string, Token> tokens_;          ///< by hash
  std::map<std::string, PageSession> sessions_;  ///< by hash
};

}  // namespace fiona::smart_web_interface
