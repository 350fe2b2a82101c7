#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "fiona/authenticator/account.pb.h"
#include "fiona/records/record_store.hpp"
#include "fiona/time.hpp"

namespace fiona::authenticator {

/// Sessions: 128 random bits each, of which only the hash is kept, here and in the database. All functions [any
/// thread]; those that change something wait for the disk, and throw Error as RecordStore does.
class Sessions {
 public:
  struct Bounds {
    Duration time{};
    std::size_t all = 0;
    std::size_t of_user = 0;
  };

  /// Takes over those of the database; none goes on for longer than `time`, whatever clock it was begun by.
  Sessions(records::RecordStore& store, TimePoint now, Duration time);

  /// Its 16 bytes. Ends the oldest ones where there are too many.
  std::string begin(const std::string& user, std::uint64_t generation, TimePoint now, const Bounds& bounds);
  std::optional<Session> find(const std::string& bytes, TimePoint now) const;
  /// False: there was none. In memory it has ended when this throws.
  bool end(const std::string& bytes);
  /// All, by the hashes under which they are kept.
  std::map<std::string, Session> all() const;
  /// Ends those of these hashes.
  void drop(const std::vector<std::string>& ended);
  std::size_t size() const;

 private:
  void end_oldest(const std::string* user, std::size_t most, std::vector<std::string>& ended);
  void forget(const std::vector<std::string>& ended);

  records::RecordStore& store_;
  mutable std::mutex mutex_;
  std::map<std::string, Session> sessions_;  ///< by hash
};

}  // namespace fiona::authenticator
