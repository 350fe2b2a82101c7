#include "own_thread.hpp"

#include "fiona/hull.hpp"

namespace fiona {

OwnThread::Shared::Shared(Hull& owner, std::shared_ptr<Strand> of) : hull(owner), strand(std::move(of)) {}

bool OwnThread::Shared::wait_for_end(std::chrono::steady_clock::time_point until) {
  std::unique_lock lock(mutex);
  return changed.wait_until(lock, until, [this] { return ended; });
}

void OwnThread::Shared::end() {
  const std::lock_guard lock(mutex);
  ended = true;
  changed.notify_all();
}

OwnThread::OwnThread(std::shared_ptr<Shared> shared) : shared_(std::move(shared)), stop_(shared_->stop.get_token()) {}

bool OwnThread::post(Job job) const {
  {
    std::unique_lock lock(shared_->mutex);
    shared_->changed.wait(lock, stop_, [this] { return shared_->posted < kMaxPosted; });
    if (stop_requested()) return false;
    ++shared_->posted;
  }
  return shared_->strand->post([shared = shared_, job = std::make_shared<Job>(std::move(job))] {
    {
      const std::lock_guard lock(shared->mutex);
      --shared->posted;
    }
    shared->changed.notify_all();
    if (shared->hull.is_active()) shared->hull.guarded([&job] { (*job)(); });
  });
}

bool OwnThread::wait_for(Duration duration) const {
  std::unique_lock lock(shared_->mutex);
  shared_->changed.wait_until(lock, stop_, saturating_sum(std::chrono::steady_clock::now(), duration),
                              [] { return false; });
  return !stop_requested();
}

bool OwnThread::await_end(std::function<Async<>()> work) const {
  const auto ended = std::make_shared<bool>(false);
  const auto end = [shared = shared_, ended] {
    {
      const std::lock_guard lock(shared->mutex);
      *ended = true;
    }
    shared->changed.notify_all();
  };
  if (!post([shared = shared_, work = std::move(work), end] { shared->hull.spawn(work(), end); })) return false;
  std::unique_lock lock(shared_->mutex);
  return shared_->changed.wait(lock, stop_, [&ended] { return *ended; });
}

}  // namespace fiona
