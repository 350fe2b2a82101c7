#include "fiona/pool.hpp"

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <deque>
#include <mutex>
#include <system_error>
#include <thread>
#include <unordered_map>
#include <utility>
#include <vector>

namespace fiona {
namespace {

/// Pieces of work that a thread does, and how long, before it looks for a descriptor that has become readable.
constexpr int kWorkPerLook = 16;
constexpr std::int64_t kLookNs = 1'000'000;
/// What epoll gives for the word that there is work; watches have other keys.
constexpr std::uint64_t kWork = 0;
/// What it gives at the times to look for work that no thread was told of.
constexpr std::uint64_t kRound = 1;
/// What it gives when it is time for what was to be done soon.
constexpr std::uint64_t kSoon = 2;
/// What it gives when nothing has happened.
constexpr std::uint64_t kNothing = ~std::uint64_t{0};

/// To wake a thread and have it run takes about this long.
constexpr std::int64_t kWakingNs = 20'000;
/// The longest that submitted work waits for the end of the run that submitted it, should that not come soon this time.
/// Rounds are made at this pace, for to set a timer for each piece costs more than the piece.
constexpr itimerspec kRounds{{0, 10'000'000}, {0, 10'000'000}};
constexpr itimerspec kNoRounds{};
constexpr itimerspec kInSoon{{0, 0}, {0, 500'000}};
/// Rounds after the last such piece, until no more are made.
constexpr int kIdleRounds = 20;
constexpr std::int64_t kRunsInMean = 16;

/// What this thread does for a pool, if anything.
struct Doing {
  const void* receiving = nullptr;  ///< the pool in whose callback of a watched descriptor it is
  const void* running = nullptr;    ///< the pool whose work it runs
  bool ends_soon = false;           ///< as that work usually does, once it has submitted something
  std::int64_t submitted_ns = 0;    ///< when it has; 0: not yet
};
thread_local Doing doing;

std::int64_t steady_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }

int checked(int result, const char* call) {
  if (result < 0) throw std::system_error(errno, std::generic_category(), call);
  return result;
}

}  // namespace

/// A descriptor that is closed at its end.
class Pool::Descriptor {
 public:
  explicit Descriptor(int number) : number_(number) {}
  ~Descriptor() { ::close(number_); }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int number() const { return number_; }

 private:
  const int number_;
};

/// A watched descriptor; outlives its guard while a thread is about to call it.
struct Pool::Watch {
  Watch(int watched, std::function<void()> call) : descriptor(watched), ready(std::move(call)) {}

  const int descriptor;
  const std::function<void()> ready;
  std::mutex mutex;  ///< held during a call
  bool stopped = false;
};

/// Idle threads all wait in one epoll, for descriptors and for the word that there is work. The kernel wakes one of
/// them for each, so that a message that comes costs one wake-up: nobody has to be told to wait in its place.
struct Pool::Threads {
  void serve();
  bool run_one(std::unique_lock<std::mutex>& lock);
  std::uint64_t look(int timeout_ms) const;
  void call(std::uint64_t key, std::unique_lock<std::mutex>& lock);
  void tell() const;
  void wake_one();
  bool takes_next();
  void set_rounds(const itimerspec& times) const;
  void end_round();
  void begin_soon();
  void control(int operation, std::uint64_t key, int descriptor, std::uint32_t events) const;

  const Descriptor epoll{checked(::epoll_create1(EPOLL_CLOEXEC), "epoll_create1")};
  const Descriptor word{checked(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK), "eventfd")};
  const Descriptor timer{checked(::timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK), "timerfd_create")};
  const Descriptor soon_timer{checked(::timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK), "timerfd_create")};
  std::mutex mutex;
  std::deque<std::shared_ptr<Runnable>> work;
  std::vector<std::shared_ptr<Runnable>> soon;
  std::unordered_map<std::uint64_t, std::shared_ptr<Watch>> watches;
  std::uint64_t next_key = kSoon + 1;
  std::size_t idle = 0;  ///< threads that wait, or are about to
  bool told = false;     ///< and none of them has heard yet
  int rounds_left = 0;   ///< more than 0 while the timer runs
  bool stopping = false;
  std::vector<std::thread> threads;
};

void Pool::Threads::control(int operation, std::uint64_t key, int descriptor, std::uint32_t events) const {
  epoll_event event{};
  event.events = events;
  event.data.u64 = key;
  checked(::epoll_ctl(epoll.number(), operation, descriptor, &event), "epoll_ctl");
}

/// A descriptor that nobody reads, edge-triggered: each writing wakes one thread.
void Pool::Threads::tell() const {
  const std::uint64_t one = 1;
  checked(static_cast<int>(::write(word.number(), &one, sizeof one)), "write to an eventfd");
}

/// Called with the lock held. Whoever hears it wakes the next if there is still more.
void Pool::Threads::wake_one() {
  if (idle == 0 || told) return;
  told = true;
  tell();
}

/// Whether this thread will run what it submits now as soon as it is done, so that no other needs to be woken: that
/// costs as much as the work. So it is with what a received message causes, and with the first piece that work submits
/// whose runs usually end soon after; should this run go on, another thread finds it on its round. Called with the lock
/// held.
bool Pool::Threads::takes_next() {
  if (doing.receiving == this) return true;
  if (doing.running != this || doing.submitted_ns > 0) return false;
  doing.submitted_ns = steady_ns();
  if (!doing.ends_soon) return false;
  if (std::exchange(rounds_left, kIdleRounds) == 0) set_rounds(kRounds);
  return true;
}

void Pool::Threads::set_rounds(const itimerspec& times) const {
  checked(::timerfd_settime(timer.number(), 0, &times, nullptr), "timerfd_settime");
}

/// The kernel begins the next one only when this one has been read. Called with the lock held.
void Pool::Threads::end_round() {
  std::uint64_t ticks = 0;
  if (::read(timer.number(), &ticks, sizeof ticks) < 0) return;  // another thread has set it meanwhile
  if (rounds_left > 0 && --rounds_left == 0) set_rounds(kNoRounds);
}

/// Called with the lock held.
void Pool::Threads::begin_soon() {
  for (auto& runnable : std::exchange(soon, {})) work.push_back(std::move(runnable));
}

void Pool::Threads::serve() {
  std::unique_lock lock(mutex);
  while (!stopping) {
    const std::int64_t begun_ns = steady_ns();
    for (int done = 0; done < kWorkPerLook && run_one(lock); ++done) {
      if (!work.empty() && steady_ns() - begun_ns > kLookNs) break;
    }
    const bool rests = work.empty();
    idle += rests ? 1 : 0;
    lock.unlock();
    const std::uint64_t key = look(rests ? -1 : 0);
    lock.lock();
    idle -= rests ? 1 : 0;
    if (key == kWork) told = false;
    if (key == kRound) end_round();
    if (key == kSoon) begin_soon();
    if (key > kSoon && key != kNothing) call(key, lock);
  }
}

bool Pool::Threads::run_one(std::unique_lock<std::mutex>& lock) {
  if (stopping || work.empty()) return false;
  auto next = std::move(work.front());
  work.pop_front();
  if (!work.empty()) wake_one();
  lock.unlock();
  const std::int64_t usual_rest_ns = next->usual_rest_ns_;
  doing = {.running = this, .ends_soon = usual_rest_ns < kWakingNs};
  next->run();
  if (doing.submitted_ns > 0) {
    next->usual_rest_ns_ = usual_rest_ns + (steady_ns() - doing.submitted_ns - usual_rest_ns) / kRunsInMean;
  }
  doing = {};
  next = nullptr;
  lock.lock();
  return true;
}

std::uint64_t Pool::Threads::look(int timeout_ms) const {
  epoll_event event{};
  return ::epoll_wait(epoll.number(), &event, 1, timeout_ms) == 1 ? event.data.u64 : kNothing;
}

void Pool::Threads::call(std::uint64_t key, std::unique_lock<std::mutex>& lock) {
  const auto found = watches.find(key);
  if (found == watches.end()) return;
  const auto watch = found->second;
  lock.unlock();
  {
    const std::lock_guard calling(watch->mutex);
    if (!watch->stopped) {
      doing = {.receiving = this};
      watch->ready();
      doing = {};
      control(EPOLL_CTL_MOD, key, watch->descriptor, EPOLLIN | EPOLLONESHOT);
    }
  }
  lock.lock();
}

Pool::Pool(std::size_t threads, std::shared_ptr<Liveness> liveness)
    : liveness_(std::move(liveness)), threads_(std::make_unique<Threads>()) {
  threads_->control(EPOLL_CTL_ADD, kWork, threads_->word.number(), EPOLLIN | EPOLLET);
  threads_->control(EPOLL_CTL_ADD, kRound, threads_->timer.number(), EPOLLIN | EPOLLET);
  threads_->control(EPOLL_CTL_ADD, kSoon, threads_->soon_timer.number(), EPOLLIN | EPOLLET);
  if (threads == 0) threads = std::max(2U, std::thread::hardware_concurrency());
  for (std::size_t i = 0; i < threads; ++i) add_thread();
}

void Pool::add_thread() {
  const std::lock_guard lock(threads_->mutex);
  threads_->threads.emplace_back([this] { threads_->serve(); });
}

Pool::~Pool() {
  {
    const std::lock_guard lock(threads_->mutex);
    threads_->stopping = true;
  }
  threads_->control(EPOLL_CTL_MOD, kWork, threads_->word.number(), EPOLLIN);  // from now on it wakes everyone
  threads_->tell();
  for (auto& thread : threads_->threads) thread.join();
}

void Pool::submit(std::shared_ptr<Runnable> runnable) {
  const std::lock_guard lock(threads_->mutex);
  threads_->work.push_back(std::move(runnable));
  if (!threads_->takes_next()) threads_->wake_one();
}

void Pool::submit_soon(std::shared_ptr<Runnable> runnable) {
  const std::lock_guard lock(threads_->mutex);
  threads_->soon.push_back(std::move(runnable));
  if (threads_->soon.size() > 1) return;
  checked(::timerfd_settime(threads_->soon_timer.number(), 0, &kInSoon, nullptr), "timerfd_settime");
}

class Pool::WatchGuard final : public Readable {
 public:
  WatchGuard(Threads& threads, std::uint64_t key, std::shared_ptr<Watch> watch)
      : threads_(threads), key_(key), watch_(std::move(watch)) {}
  /// The descriptor's owner may close it as soon as this has returned.
  ~WatchGuard() override {
    {
      const std::lock_guard calling(watch_->mutex);
      watch_->stopped = true;
      threads_.control(EPOLL_CTL_DEL, key_, watch_->descriptor, 0);
    }
    const std::lock_guard lock(threads_.mutex);
    threads_.watches.erase(key_);
  }

 private:
  Threads& threads_;
  const std::uint64_t key_;
  const std::shared_ptr<Watch> watch_;
};

std::unique_ptr<Pool::Readable> Pool::watch(int descriptor, std::function<void()> ready) {
  const auto watch = std::make_shared<Watch>(descriptor, std::move(ready));
  const std::lock_guard lock(threads_->mutex);
  const std::uint64_t key = threads_->next_key++;
  threads_->control(EPOLL_CTL_ADD, key, descriptor, EPOLLIN | EPOLLONESHOT);
  threads_->watches.emplace(key, watch);
  return std::make_unique<WatchGuard>(*threads_, key, watch);
}

}  // namespace fiona
