#include "login_desk.hpp"

#include <pthread.h>
#include <sys/resource.h>
#include <unistd.h>

#include <utility>

namespace fiona::authenticator {
namespace {

/// Behind what guides, and still served on a machine that is busy: at 15 a login waits for half a minute there.
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
  for (const Attempt& attempt : left) attempt.abandon();
  thread_.join();
}

bool LoginDesk::take(Attempt&& attempt) {
  {
    const std::lock_guard lock(mutex_);
    if (closed_ || attempts_.size() >= kMaxWaiting || of_source_[attempt.source] >= kMaxOfSource) return false;
    ++of_source_[attempt.source];
    attempts_.push_back(std::move(attempt));
  }
  wake_.notify_one();
  return true;
}

std::size_t LoginDesk::waiting() const {
  const std::lock_guard lock(mutex_);
  return attempts_.size();
}

void LoginDesk::work() {
  pthread_setname_np(pthread_self(), "passwords");
  // Linux has a niceness for each thread.
  ::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), kNice);
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return closed_ || !attempts_.empty(); });
    if (closed_) return;
    const Attempt attempt = std::move(attempts_.front());
    attempts_.pop_front();
    lock.unlock();
    attempt.check(attempt);
    lock.lock();
    if (const auto found = of_source_.find(attempt.source); --found->second == 0) of_source_.erase(found);
  }
}

}  // namespace fiona::authenticator
