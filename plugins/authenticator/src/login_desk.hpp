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
/// others nothing but what is left of the CPU. Attempts have their bound, and each source its own; who has failed is
/// served after those who have not, the newest first, and gives them its place where there is none.
class LoginDesk {
 public:
  static constexpr std::size_t kMaxWaiting = 32;
  static constexpr std::size_t kMaxOfSource = 2;

  struct Attempt {
    std::string user;
    Secret password;
    std::string source;
    double used = 0;                                    ///< how many attempts the source has used up lately
    std::function<void(const Attempt& attempt)> check;  ///< on the desk's thread
    std::function<void(const char* why)> abandon;       ///< instead of it, on any thread
  };

  LoginDesk();
  /// Waits for the attempt that is being checked, and abandons the others.
  ~LoginDesk();
  LoginDesk(const LoginDesk&) = delete;
  LoginDesk& operator=(const LoginDesk&) = delete;

  static constexpr const char* kCrowded = "many log in at this moment: try again in a second";

  /// False, and nothing is kept: too many wait, from this source, or in all that have used up less than it.
  bool take(Attempt&& attempt);
  std::size_t waiting() const;

 private:
  void work();
  void leave(const std::string& source);

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  bool closed_ = false;
  std::deque<Attempt> attempts_;
  std::map<std::string, std::size_t> of_source_;  ///< those that wait or are being checked
  std::thread thread_;                            ///< the last: it uses the others
};

}  // namespace fiona::authenticator
