#include "accounts.hpp"

#include <sodium.h>

#include <algorithm>
#include <cstdint>
#include <vector>

#include "fiona/error.hpp"

namespace fiona::authenticator {
namespace {

constexpr std::string_view kAccounts = "account";
constexpr std::size_t kLongestName = 64;

std::string checked_name(std::string_view typed) {
  if (auto name = account_name(typed)) return *name;
  throw Error(ErrorCode::Usage,
              {.what = "this cannot be the name of a user",
               .expected = "1 to 64 of a-z, 0-9, '.', '_', '-', '@', beginning with a letter or digit",
               .found = std::to_string(typed.size()) + " bytes with others in them"});
}

void check_level(int level) {
  if (level >= 0 && level <= kHighestLevel) return;
  throw Error(ErrorCode::Usage,
              {.what = "there is no such level", .expected = "0 to 9", .found = std::to_string(level)});
}

Account account_of(const std::string& bytes) {
  Account account;
  account.ParseFromString(bytes);  // whole, since its seal is
  return account;
}

}  // namespace

std::optional<std::string> account_name(std::string_view typed) {
  const auto is_word = [](char c) { return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9'); };
  const auto is_mark = [](char c) { return c == '.' || c == '_' || c == '-' || c == '@'; };
  std::string name(typed);
  std::transform(name.begin(), name.end(), name.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  const bool fits = !name.empty() && name.size() <= kLongestName && is_word(name.front()) &&
                    std::all_of(name.begin(), name.end(), [&](char c) { return is_word(c) || is_mark(c); });
  return fits ? std::optional(std::move(name)) : std::nullopt;
}

std::optional<Account> Accounts::find(const std::string& name) const {
  const auto bytes = store_.get(kAccounts, name);
  return bytes ? std::optional(account_of(*bytes)) : std::nullopt;
}

std::map<std::string, Account> Accounts::all() const {
  std::map<std::string, Account> accounts;
  for (const auto& [name, bytes] : store_.all(kAccounts)) accounts.emplace(name, account_of(bytes));
  return accounts;
}

Error Accounts::nobody(const std::string& name) const {
  std::vector<std::string> names;
  for (const auto& [known, account] : all()) names.push_back(known);
  return Error(ErrorCode::NotFound, {.what = "there is no user '" + name + "'",
                                     .where = store_.file().string(),
                                     .next = "fiona-users list",
                                     .near = nearest_names(name, names)});
}

/// Tried again where another process has changed the same user meanwhile.
template <class Change>
void Accounts::change(std::string_view typed, Change make) {
  const std::string name = checked_name(typed);
  for (bool done = false; !done;) {
    const auto before = store_.get(kAccounts, name);
    if (!before) throw nobody(name);
    Account account = account_of(*before);
    make(account);
    done = store_.exchange(kAccounts, name, before, account.SerializeAsString());
  }
}

void Accounts::add(std::string_view typed, const Secret& password, int level) {
  const std::string name = checked_name(typed);
  check_level(level);
  check_new_password(password, name);
  Account account;
  account.set_hash(hash_of(password));
  account.set_level(level);
  // Not 0: who had the name before may have sessions yet.
  std::uint64_t generation = 0;
  randombytes_buf(&generation, sizeof(generation));
  account.set_generation(generation);
  if (!store_.exchange(kAccounts, name, std::nullopt, account.SerializeAsString())) {
    throw Error(ErrorCode::Failed, {.what = "there is a user '" + name + "' already",
                                    .where = store_.file().string(),
                                    .next = "fiona-users passwd " + name + " sets another password"});
  }
}

void Accounts::set_password(std::string_view typed, const Secret& password) {
  check_new_password(password, checked_name(typed));
  const std::string hash = hash_of(password);
  change(typed, [&](Account& account) {
    account.set_hash(hash);
    account.set_generation(account.generation() + 1);
  });
}

void Accounts::set_level(std::string_view typed, int level) {
  check_level(level);
  change(typed, [&](Account& account) { account.set_level(level); });
}

void Accounts::set_disabled(std::string_view typed, bool disabled) {
  change(typed, [&](Account& account) {
    account.set_disabled(disabled);
    account.set_generation(account.generation() + 1);
  });
}

void Accounts::remove(std::string_view typed) {
  const std::string name = checked_name(typed);
  if (!store_.erase(kAccounts, name)) throw nobody(name);
}

}  // namespace fiona::authenticator
