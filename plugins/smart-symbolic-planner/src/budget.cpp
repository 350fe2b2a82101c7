#include "budget.hpp"

#include <algorithm>
#include <utility>

namespace fiona::planning {

void* Memory::do_allocate(std::size_t bytes, std::size_t alignment) {
  if (bytes > limit_ || used_ + kOverhead > limit_ - bytes) throw OutOfMemory();
  void* block = std::pmr::new_delete_resource()->allocate(bytes, alignment);
  used_ += bytes + kOverhead;
  peak_ = std::max(peak_, used_);
  return block;
}

void Memory::do_deallocate(void* block, std::size_t bytes, std::size_t alignment) {
  used_ -= bytes + kOverhead;
  std::pmr::new_delete_resource()->deallocate(block, bytes, alignment);
}

bool Pace::look() {
  until_look_ = kLookEvery;
  const auto in_slice = Clock::now() - slice_begin_;
  if (spent_ + in_slice > bound_) throw OutOfTime();
  return in_slice >= slice_;
}

void Pace::run(const Async<>& work, Clock::duration slice) {
  slice_begin_ = Clock::now();
  slice_ = slice;
  if (const auto paused = std::exchange(paused_, {})) {
    paused.resume();
  } else {
    work.start();
  }
  spent_ += Clock::now() - slice_begin_;
}

}  // namespace fiona::planning
