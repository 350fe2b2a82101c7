#include "page_sessions.hpp"

#include <sodium.h>

#include <algorithm>

namespace fiona::smart_web_interface {
namespace {

constexpr std::string_view kTable = "session";
constexpr std::size_t kTokenBytes = 16;
constexpr std::size_t kKeyBytes = 32;

std::string hex(std::string_view bytes) {
  std::string text(2 * bytes.size() + 1, '\0');
  sodium_bin2hex(text.data(), text.size(), reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
  text.pop_back();
  return text;
}

std::string random_number(std::size_t bytes) {
  std::string random(bytes, '\0');
  randombytes_buf(random.data(), random.size());
  return hex(random);
}

/// What a secret is good for is part of its hash, so that the one kept in the file opens nothing.
std::string hash_of(std::string_view secret, std::string_view purpose) {
  std::string hash(crypto_generichash_BYTES, '\0');
  crypto_generichash_state state;
  crypto_generichash_init(&state, nullptr, 0, hash.size());
  for (const std::string_view part : {purpose, secret}) {
    crypto_generichash_update(&state, reinterpret_cast<const unsigned char*>(part.data()), part.size());
  }
  crypto_generichash_final(&state, reinterpret_cast<unsigned char*>(hash.data()), hash.size());
  return hash;
}

std::string name_of(std::string_view secret) { return hex(hash_of(secret, "fiona page name: ")); }

const unsigned char* bytes_of(const std::string& text) { return reinterpret_cast<const unsigned char*>(text.data()); }

std::string sealed(const std::string& plain, const std::string& session) {
  std::string nonce(crypto_secretbox_NONCEBYTES, '\0');
  randombytes_buf(nonce.data(), nonce.size());
  std::string box(crypto_secretbox_MACBYTES + plain.size(), '\0');
  crypto_secretbox_easy(reinterpret_cast<unsigned char*>(box.data()), bytes_of(plain), plain.size(), bytes_of(nonce),
                        bytes_of(hash_of(session, "fiona page user: ")));
  return nonce + box;
}

std::optional<std::string> unsealed(const std::string& box, const std::string& session) {
  constexpr std::size_t kLeast = crypto_secretbox_NONCEBYTES + crypto_secretbox_MACBYTES;
  if (box.size() < kLeast) return std::nullopt;
  std::string plain(box.size() - kLeast, '\0');
  const bool whole =
      crypto_secretbox_open_easy(reinterpret_cast<unsigned char*>(plain.data()),
                                 bytes_of(box) + crypto_secretbox_NONCEBYTES, box.size() - crypto_secretbox_NONCEBYTES,
                                 bytes_of(box), bytes_of(hash_of(session, "fiona page user: "))) == 0;
  return whole ? std::optional(plain) : std::nullopt;
}

}  // namespace

PageSessions::PageSessions(records::RecordStore& store, TimePoint now, Duration time)
    : store_(store), key_(random_number(kKeyBytes)) {
  for (const auto& [name, bytes] : store_.all(kTable)) {
    PageSession session;
    session.ParseFromString(bytes);
    session.set_expires_ms(std::min(session.expires_ms(), to_milliseconds(now + time)));
    sessions_.emplace(name, std::move(session));
  }
  forget_expired(now);
}

void PageSessions::forget_expired(TimePoint now) {
  std::erase_if(tokens_, [now](const auto& token) { return token.second.end <= now; });
  for (auto i = sessions_.begin(); i != sessions_.end();) {
    if (i->second.expires_ms() > to_milliseconds(now)) {
      ++i;
      continue;
    }
    store_.erase(kTable, i->first);
    i = sessions_.erase(i);
  }
}

std::string PageSessions::make_token(TimePoint now) {
  const std::lock_guard lock(mutex_);
  forget_expired(now);
  if (tokens_.size() >= kMaxTokens) {
    const auto rank = [](const auto& token) { return std::pair(token.second.opened.empty(), token.second.end); };
    tokens_.erase(std::min_element(tokens_.begin(), tokens_.end(),
                                   [&](const auto& a, const auto& b) { return rank(a) < rank(b); }));
  }
  std::string token = random_number(kTokenBytes);
  tokens_.emplace(name_of(token), Token{now + kTokenTime, {}});
  return token;
}

std::optional<std::string> PageSessions::open(const std::string& token, const std::string& number, TimePoint now,
                                              Duration time) {
  const std::lock_guard lock(mutex_);
  forget_expired(now);
  const auto found = tokens_.find(name_of(token));
  if (found == tokens_.end()) return std::nullopt;
  // Worked out, so that it can be given again though nobody but the page keeps it.
  std::string session = hex(hash_of(key_ + token + number, "fiona page session: "));
  const std::string name = name_of(session);
  std::string& opened = found->second.opened;
  if (!opened.empty()) {
    const bool again = sodium_memcmp(opened.data(), name.data(), name.size()) == 0 && find(session, now) != nullptr;
    return again ? std::optional(session) : std::nullopt;
  }
  opened = name;
  if (sessions_.size() >= kMaxSessions) {
    const auto oldest = std::min_element(sessions_.begin(), sessions_.end(), [](const auto& a, const auto& b) {
      return a.second.expires_ms() < b.second.expires_ms();
    });
    store_.erase(kTable, oldest->first);
    sessions_.erase(oldest);
  }
  PageSession kept;
  kept.set_expires_ms(to_milliseconds(now + time));
  store_.put(kTable, name, kept.SerializeAsString());
  sessions_.emplace(name, std::move(kept));
  return session;
}

const PageSession* PageSessions::find(const std::string& session, TimePoint now) const {
  const auto found = sessions_.find(name_of(session));
  return found != sessions_.end() && found->second.expires_ms() > to_milliseconds(now) ? &found->second : nullptr;
}

bool PageSessions::is_open(const std::string& session, TimePoint now) const {
  const std::lock_guard lock(mutex_);
  return find(session, now) != nullptr;
}

std::optional<PageUser> PageSessions::user(const std::string& session, TimePoint now) const {
  const std::lock_guard lock(mutex_);
  const PageSession* found = find(session, now);
  const auto plain = found ? unsealed(found->user(), session) : std::nullopt;
  if (!plain) return std::nullopt;
  PageUser user;
  user.ParseFromString(*plain);
  return user;
}

bool PageSessions::set_user(const std::string& session, const std::optional<PageUser>& user, TimePoint now) {
  const std::lock_guard lock(mutex_);
  const PageSession* found = find(session, now);
  if (!found) return false;
  PageSession changed = *found;
  changed.set_user(user ? sealed(user->SerializeAsString(), session) : "");
  store_.put(kTable, name_of(session), changed.SerializeAsString());
  sessions_[name_of(session)] = std::move(changed);
  return true;
}

}  // namespace fiona::smart_web_interface
