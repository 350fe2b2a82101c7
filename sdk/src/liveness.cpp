#include "fiona/liveness.hpp"

#include <sys/mman.h>

#include <algorithm>
#include <new>

#include "fiona/error.hpp"

namespace fiona {

namespace {

Liveness::Page* map_page() {
  void* page = ::mmap(nullptr, sizeof(Liveness::Page), PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (page == MAP_FAILED) throw std::bad_alloc();
  return static_cast<Liveness::Page*>(page);
}

}  // namespace

void Liveness::Unmap::operator()(Page* page) const { ::munmap(page, sizeof(Page)); }

Liveness::Liveness() : own_(map_page()), page_(own_.get()) {}

Liveness::Slot& Liveness::take(std::string_view name) {
  const std::lock_guard lock(mutex_);
  if (free_.empty()) {
    const std::uint32_t next = page_->used.load(std::memory_order_relaxed);
    if (next >= kSlots) {
      throw Error(ErrorCode::NotAllowed, {.what = "this process holds as many instances as it can watch",
                                          .found = std::to_string(kSlots),
                                          .next = "load it in another group"});
    }
    free_.push_back(&page_->slots[next]);
    page_->used.store(next + 1, std::memory_order_relaxed);
  }
  Slot& slot = *free_.back();
  free_.pop_back();
  const std::size_t length = std::min(name.size(), sizeof slot.name - 1);
  std::fill(std::copy_n(name.begin(), length, slot.name), std::end(slot.name), '\0');
  return slot;
}

void Liveness::give_back(Slot& slot) {
  const std::lock_guard lock(mutex_);
  slot.work.store(0, std::memory_order_relaxed);
  free_.push_back(&slot);
}

Liveness::Place::Place(std::shared_ptr<Liveness> of, std::string_view name)
    : of_(std::move(of)), slot_(of_ ? &of_->take(name) : nullptr) {}

Liveness::Place::~Place() {
  if (slot_) of_->give_back(*slot_);
}

}  // namespace fiona
