#include "login_desk.hpp"

#include <pthread.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <optional>
#include <utility>

namespace fiona::authenticator {
namespace {

/// Behind what guides, and still served on a machine that is busy: at 15 a login waits for half a minute there. More
/// than the others of the process have.
constexpr int kNice = 5;

}  // namespace

LoginDesk::LoginDesk() : thread_([this] { work(); }) {}

LoginDesk::~LoginDesk() {
  std::deque<Attempt> left;
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    left.swap(attempts_);
  }
  wake_.notify_one();
  for (const Attempt& attempt : left) attempt.abandon("the authenticator ends");
  thread_.join();
}

bool LoginDesk::take(Attempt&& attempt) {
  std::optional<Attempt> displaced;
  {
    const std::lock_guard lock(mutex_);
    const auto own = of_source_.find(attempt.source);
    if (closed_ || (own != of_source_.end() && own->second >= kMaxOfSource)) return false;
    if (attempts_.size() >= kMaxWaiting) {
      if (attempts_.back().used < attempt.used) return false;
      displaced = std::move(attempts_.back());
      attempts_.pop_back();
      leave(displaced->source);
    }
    ++of_source_[attempt.source];
    // The newest first among equals: those before it, in a storm, are the storm.
    const auto place = std::lower_bound(attempts_.begin(), attempts_.end(), attempt.used,
                                        [](const Attempt& other, double used) { return other.used < used; });
    attempts_.insert(place, std::move(attempt));
  }
  wake_.notify_one();
  if (displaced) displaced->abandon(kCrowded);
  return true;
}

void LoginDesk::leave(const std::string& source) {
  if (const auto found = of_source_.find(source); --found->second == 0) of_source_.erase(found);
}

std::size_t LoginDesk::waiting() const {
  const std::lock_guard lock(mutex_);
  return attempts_.size();
}

void LoginDesk::work() {
  pthread_setname_np(pthread_self(), "passwords");
  // Linux has a niceness for each thread.
  const auto self = static_cast<id_t>(::gettid());
  ::setpriority(PRIO_PROCESS, self, ::getpriority(PRIO_PROCESS, self) + kNice);
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return closed_ || !attempts_.empty(); });
    if (closed_) return;
    const Attempt attempt = std::move(attempts_.front());
    attempts_.pop_front();
    lock.unlock();
    attempt.check(attempt);
    lock.lock();
    leave(attempt.source);
  }
}

}  // namespace fiona::authenticator
