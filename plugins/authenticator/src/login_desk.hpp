#pragma once

#include <atomic>
#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>

#include "password.hpp"

namespace fiona::authenticator {

/// Where attempts wait for the one thread that hashes, less urgent than the others of the process: a storm costs the
/// others nothing but what is left of the CPU. Attempts have their bound, and each source its own, so that one that
/// makes many is behind itself and not in front of others.
class LoginDesk {
 public:
  static constexpr std::size_t kMaxWaiting = 32;
  static constexpr std::size_t kMaxOfSource = 2;

  struct Attempt {
    std::string user;
    Secret password;
    std::string source;
    std::function<void(const Attempt& attempt)> check;  ///< on the desk's thread
    std::function<void()> abandon;                      ///< instead of it, when the desk closes
  };

  LoginDesk();
  /// Waits for the attempt that is being checked, and abandons the others.
  ~LoginDesk();
  LoginDesk(const LoginDesk&) = delete;
  LoginDesk& operator=(const LoginDesk&) = delete;

  /// False, and nothing is kept: too many wait, in all or from this source.
  bool take(Attempt&& attempt);
  std::size_t waiting() const;

 private:
  void work();

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  bool closed_ = false;
  std::deque<Attempt> attempts_;
  std::map<std::string, std::size_t> of_source_;  ///< those that wait or are being checked
  std::thread thread_;                            ///< the last: it uses the others
};

}  // namespace fiona::authenticator
