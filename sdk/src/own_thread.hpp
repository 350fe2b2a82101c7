#pragma once

#include <condition_variable>
#include <mutex>

#include "fiona/own_thread.hpp"

namespace fiona {

/// Between the thread of a free running task and the strand. It outlives both.
struct OwnThread::Shared {
  Shared(Hull& owner, std::shared_ptr<Strand> of);

  /// [any thread] False if the thread has not ended by then, on the machine's clock.
  bool wait_for_end(std::chrono::steady_clock::time_point until);
  /// [the thread] The last that it does.
  void end();

  Hull& hull;  ///< touched on its strand only, which is closed before it goes
  const std::shared_ptr<Strand> strand;
  std::stop_source stop;
  std::mutex mutex;
  std::condition_variable_any changed;
  std::size_t posted = 0;
  bool ended = false;
};

}  // namespace fiona
