#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "fiona/authenticator/account.pb.h"
#include "fiona/error.hpp"
#include "fiona/records/record_store.hpp"
#include "password.hpp"

namespace fiona::authenticator {

inline constexpr std::string_view kDatabaseKind = "users";
inline constexpr int kHighestLevel = 9;

/// The name as accounts have it: ASCII letters small, as a phone's keyboard makes the first one large. Nothing if it
/// cannot be one: 1 to 64 of a-z, 0-9, '.', '_', '-', '@', not beginning with one of the last four. So every name is
/// inert wherever it is shown.
std::optional<std::string> account_name(std::string_view typed);

/// The users of a database. All functions [any thread]; they throw Error as RecordStore does, NotFound for a name that
/// nobody has, and Usage for what is none.
class Accounts {
 public:
  explicit Accounts(records::RecordStore& store) : store_(store) {}

  std::optional<Account> find(const std::string& name) const;
  std::map<std::string, Account> all() const;

  /// Throws Error (Failed) if there is one.
  void add(std::string_view name, const Secret& password, int level);
  /// Each ends the user's sessions, but a change of the level.
  void set_password(std::string_view name, const Secret& password);
  void set_level(std::string_view name, int level);
  void set_disabled(std::string_view name, bool disabled);
  void remove(std::string_view name);

 private:
  template <class Change>
  void change(std::string_view typed, Change make);
  Error nobody(const std::string& name) const;

  records::RecordStore& store_;
};

}  // namespace fiona::authenticator
