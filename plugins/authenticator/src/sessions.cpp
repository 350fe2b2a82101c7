#include "sessions.hpp"

#include <sodium.h>

#include <algorithm>

#include "fiona/error.hpp"

namespace fiona::authenticator {
namespace {

constexpr std::string_view kSessions = "session";
constexpr std::size_t kBytes = 16;

std::string name_of(const std::string& bytes) {
  unsigned char hash[crypto_generichash_BYTES];
  crypto_generichash(hash, sizeof(hash), reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), nullptr,
                     0);
  std::string hex(2 * sizeof(hash) + 1, '\0');
  sodium_bin2hex(hex.data(), hex.size(), hash, sizeof(hash));
  hex.pop_back();
  return hex;
}

}  // namespace

Sessions::Sessions(records::RecordStore& store, TimePoint now, Duration time) : store_(store) {
  std::vector<std::string> ended;
  const std::int64_t latest_ms = to_milliseconds(now + time);
  for (const auto& [name, bytes] : store_.all(kSessions)) {
    Session session;
    session.ParseFromString(bytes);
    if (session.expires_ms() > to_milliseconds(now)) {
      if (session.expires_ms() > latest_ms) {
        session.set_expires_ms(latest_ms);
        store_.put(kSessions, name, session.SerializeAsString());
      }
      sessions_.emplace(name, std::move(session));
    } else {
      ended.push_back(name);
    }
  }
  forget(ended);
}

void Sessions::end_oldest(const std::string* user, std::size_t most, std::vector<std::string>& ended) {
  std::vector<std::map<std::string, Session>::iterator> found;
  for (auto i = sessions_.begin(); i != sessions_.end(); ++i) {
    if (!user || i->second.user() == *user) found.push_back(i);
  }
  if (found.size() < most) return;
  const auto older = [](const auto& a, const auto& b) { return a->second.expires_ms() < b->second.expires_ms(); };
  std::sort(found.begin(), found.end(), older);
  for (std::size_t i = 0; i + most <= found.size(); ++i) {
    ended.push_back(found[i]->first);
    sessions_.erase(found[i]);
  }
}

std::string Sessions::begin(const std::string& user, std::uint64_t generation, TimePoint now, const Bounds& bounds) {
  std::string bytes(kBytes, '\0');
  randombytes_buf(bytes.data(), bytes.size());
  const std::string name = name_of(bytes);
  Session session;
  session.set_user(user);
  session.set_generation(generation);
  session.set_expires_ms(to_milliseconds(now + bounds.time));
  // On the disk first: a session that somebody has been given is there after a restart.
  store_.put(kSessions, name, session.SerializeAsString());
  std::vector<std::string> ended;
  {
    const std::lock_guard lock(mutex_);
    end_oldest(&user, bounds.of_user, ended);
    end_oldest(nullptr, bounds.all, ended);
    sessions_.emplace(name, std::move(session));
  }
  forget(ended);
  return bytes;
}

std::optional<Session> Sessions::find(const std::string& bytes, TimePoint now) const {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(name_of(bytes));
  if (found == sessions_.end() || found->second.expires_ms() <= to_milliseconds(now)) return std::nullopt;
  return found->second;
}

bool Sessions::end(const std::string& bytes) {
  const std::string name = name_of(bytes);
  {
    const std::lock_guard lock(mutex_);
    if (sessions_.erase(name) == 0) return false;
  }
  forget({name});
  return true;
}

std::map<std::string, Session> Sessions::all() const {
  const std::lock_guard lock(mutex_);
  return sessions_;
}

void Sessions::drop(const std::vector<std::string>& ended) {
  {
    const std::lock_guard lock(mutex_);
    for (const std::string& name : ended) sessions_.erase(name);
  }
  forget(ended);
}

std::size_t Sessions::size() const {
  const std::lock_guard lock(mutex_);
  return sessions_.size();
}

void Sessions::forget(const std::vector<std::string>& ended) {
  for (const std::string& name : ended) store_.erase(kSessions, name);
}

}  // namespace fiona::authenticator
