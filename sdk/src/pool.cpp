#include <utility>  // before Asio's coroutine support, which g++ 12 needs

#include "fiona/pool.hpp"

#include <algorithm>
#include <boost/asio/defer.hpp>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/post.hpp>
#include <mutex>
#include <thread>
#include <vector>

namespace fiona {

namespace asio = boost::asio;

struct Pool::Threads {
  asio::io_context context;
  asio::executor_work_guard<asio::io_context::executor_type> work = asio::make_work_guard(context);
  std::vector<std::thread> threads;
};

Pool::Pool(std::size_t threads) : threads_(std::make_unique<Threads>()) {
  if (threads == 0) threads = std::max(2U, std::thread::hardware_concurrency());
  for (std::size_t i = 0; i < threads; ++i) {
    threads_->threads.emplace_back([this] { threads_->context.run(); });
  }
}

Pool::~Pool() {
  threads_->context.stop();
  for (auto& thread : threads_->threads) thread.join();
}

namespace {

/// Whether this thread is in the callback of a watched descriptor.
thread_local bool receiving = false;

}  // namespace

void Pool::submit(std::shared_ptr<Runnable> runnable) {
  auto run = [runnable = std::move(runnable)] { runnable->run(); };
  // What a received message causes runs next on the thread that received it: to wake another costs as much as the work.
  receiving ? asio::defer(threads_->context, std::move(run)) : asio::post(threads_->context, std::move(run));
}

namespace {

/// Waits, calls, waits again; outlives its guard while a call is under way.
class Watch : public std::enable_shared_from_this<Watch> {
 public:
  Watch(asio::io_context& context, int descriptor, std::function<void()> ready)
      : descriptor_(context, descriptor), ready_(std::move(ready)) {}

  void wait() {
    descriptor_.async_wait(asio::posix::descriptor_base::wait_read,
                           [self = shared_from_this()](const boost::system::error_code& error) { self->on_readable(error); });
  }
  /// The descriptor's owner may close it as soon as this has returned, so it is not only cancelled but given back.
  void stop() {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
    descriptor_.release();
  }

 private:
  void on_readable(const boost::system::error_code& error) {
    const std::lock_guard lock(mutex_);
    if (stopped_ || error) return;
    receiving = true;
    ready_();
    receiving = false;
    wait();
  }

  std::mutex mutex_;
  bool stopped_ = false;
  asio::posix::stream_descriptor descriptor_;
  const std::function<void()> ready_;
};

class WatchGuard final : public Pool::Readable {
 public:
  explicit WatchGuard(std::shared_ptr<Watch> watch) : watch_(std::move(watch)) { watch_->wait(); }
  ~WatchGuard() override { watch_->stop(); }

 private:
  const std::shared_ptr<Watch> watch_;
};

}  // namespace

std::unique_ptr<Pool::Readable> Pool::watch(int descriptor, std::function<void()> ready) {
  return std::make_unique<WatchGuard>(std::make_shared<Watch>(threads_->context, descriptor, std::move(ready)));
}

}  // namespace fiona
