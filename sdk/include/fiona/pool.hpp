#pragma once

#include <cstddef>
#include <functional>
#include <memory>

#include "fiona/strand.hpp"

namespace fiona {

/// The threads of a host or group, for strands and for descriptors that become readable.
class Pool final : public Executor {
 public:
  /// `threads` of 0: one per core, at least two.
  explicit Pool(std::size_t threads = 0, std::shared_ptr<Liveness> liveness = nullptr);
  /// Stops: work that waits is dropped, work that runs is waited for.
  ~Pool() override;

  /// Wakes an idle thread; but what work of this pool submits first runs on the same thread after that work, where it
  /// usually ends within 20 us: at the latest 10 ms later, on another one, should it go on this time.
  void submit(std::shared_ptr<Runnable> runnable) override;
  /// In 500 us, and wakes nobody before: for work that gets cheaper by what comes meanwhile.
  void submit_soon(std::shared_ptr<Runnable> runnable);
  std::shared_ptr<Liveness> liveness() const override { return liveness_; }

  /// [any thread] In the place of one that does not come back from its work.
  void add_thread();

  /// Calls `ready` on a pool thread whenever `descriptor` becomes readable, until the guard is destroyed. The guard's
  /// destruction waits for a call that is running, so it must not happen inside one. The descriptor stays the caller's.
  class Readable;
  std::unique_ptr<Readable> watch(int descriptor, std::function<void()> ready);

 private:
  class Descriptor;
  struct Watch;
  class WatchGuard;
  struct Threads;
  const std::shared_ptr<Liveness> liveness_;
  std::unique_ptr<Threads> threads_;
};

class Pool::Readable {
 public:
  virtual ~Readable() = default;
};

}  // namespace fiona
