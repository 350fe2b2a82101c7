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
  explicit Pool(std::size_t threads = 0);
  /// Stops: work that waits is dropped, work that runs is waited for.
  ~Pool() override;

  void submit(std::shared_ptr<Runnable> runnable) override;

  /// Calls `ready` on a pool thread whenever `descriptor` becomes readable, until the guard is destroyed. The guard's
  /// destruction waits for a call that is running, so it must not happen inside one. The descriptor stays the caller's.
  class Readable;
  std::unique_ptr<Readable> watch(int descriptor, std::function<void()> ready);

 private:
  class Descriptor;
  struct Watch;
  class WatchGuard;
  struct Threads;
  std::unique_ptr<Threads> threads_;
};

class Pool::Readable {
 public:
  virtual ~Readable() = default;
};

}  // namespace fiona
