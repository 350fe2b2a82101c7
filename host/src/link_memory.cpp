#include "link_memory.hpp"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstring>

#include "fiona/error.hpp"
#include "os/shared_memory.hpp"

namespace fiona::host {
namespace {

using Count = std::atomic<std::uint64_t>;
static_assert(Count::is_always_lock_free, "two processes count in it");

/// Ahead of the slots, a page: how often this memory's owner has done with each of the other one's.
struct Header {
  std::array<Count, kMemorySlots> released{};
};
constexpr std::size_t kHeaderBytes = 4096;
constexpr std::size_t kMemoryBytes = kHeaderBytes + kMemorySlots * kLocalChunkBytes;
static_assert(sizeof(Header) <= kHeaderBytes);

constexpr std::size_t begin_of(std::size_t slot) { return kHeaderBytes + slot * kLocalChunkBytes; }
char* slot_of(void* memory, std::size_t slot) { return static_cast<char*>(memory) + begin_of(slot); }

/// The third part of a message: slot and size, 4 bytes each, little endian.
constexpr std::size_t kPlaceBytes = 8;

zmq::message_t place_of(std::size_t slot, std::size_t size) {
  zmq::message_t place(kPlaceBytes);
  auto* out = static_cast<std::uint8_t*>(place.data());
  for (int i = 0; i < 4; ++i) {
    out[i] = static_cast<std::uint8_t>(slot >> (8 * i));
    out[4 + i] = static_cast<std::uint8_t>(size >> (8 * i));
  }
  return place;
}

std::uint32_t number_in(const zmq::message_t& place, std::size_t begin) {
  const auto* in = static_cast<const std::uint8_t*>(place.data()) + begin;
  return in[0] | static_cast<std::uint32_t>(in[1]) << 8U | static_cast<std::uint32_t>(in[2]) << 16U |
         static_cast<std::uint32_t>(in[3]) << 24U;
}

std::atomic<int> memories{0};  // of this process

}  // namespace

class LinkMemory::Ours {
 public:
  Ours() {
    if (!memory_.reserve(0, kHeaderBytes))
      throw Error(ErrorCode::Failed, {.what = "no memory is left", .next = "free -m"});
    ++memories;
  }
  ~Ours() { --memories; }
  Ours(const Ours&) = delete;
  Ours& operator=(const Ours&) = delete;

  int descriptor() const { return memory_.descriptor(); }
  void forget_descriptor() { memory_.forget_descriptor(); }
  /// False: there is no memory for it.
  bool fill(std::size_t slot, std::string_view chunk) {
    if (chunk.size() > reserved_[slot] && !memory_.reserve(begin_of(slot), chunk.size())) return false;
    reserved_[slot] = std::max(reserved_[slot], chunk.size());
    std::memcpy(slot_of(memory_.data(), slot), chunk.data(), chunk.size());
    return true;
  }
  void release(std::size_t slot) {
    static_cast<Header*>(memory_.data())->released[slot].fetch_add(1, std::memory_order_release);
  }

 private:
  os::SharedMemory memory_{kMemoryBytes};
  std::array<std::size_t, kMemorySlots> reserved_{};  ///< bytes of each slot that can be written
};

class LinkMemory::Theirs {
 public:
  explicit Theirs(const wire::Memory& offered) : memory_(offered.process(), offered.file_descriptor(), kMemoryBytes) {}
  char* slot(std::size_t slot) const { return slot_of(memory_.data(), slot); }
  std::uint64_t released(std::size_t slot) const {
    return static_cast<const Header*>(memory_.data())->released[slot].load(std::memory_order_acquire);
  }

 private:
  const os::SharedMemory memory_;
};

/// A slot that a message shows, until ZeroMQ lets go of that.
struct LinkMemory::Lent {
  std::shared_ptr<const Theirs> of;
  std::shared_ptr<Ours> noted_in;
  std::size_t slot;

  static void done(void*, void* hint) {
    const std::unique_ptr<Lent> self(static_cast<Lent*>(hint));
    self->noted_in->release(self->slot);
  }
};

std::optional<wire::Memory> LinkMemory::offer() {
  if (ours_ || declined_) return std::nullopt;
  wire::Memory offered = make();
  if (!ours_) return std::nullopt;
  return offered;
}

/// Without memory or descriptors the link does without: a decline.
wire::Memory LinkMemory::make() {
  if (memories >= kMostMemories) return decline();
  try {
    ours_ = std::make_shared<Ours>();
  } catch (const Error&) {
    return decline();
  }
  wire::Memory offered;
  offered.set_process(::getpid());
  offered.set_file_descriptor(ours_->descriptor());
  return offered;
}

wire::Memory LinkMemory::decline() {
  declined_ = true;
  is_seen_ = false;
  ours_ = nullptr;
  theirs_ = nullptr;
  return {};
}

std::optional<wire::Memory> LinkMemory::on_told(const wire::Memory& told) {
  const bool offers = told.file_descriptor() != 0;
  if (!offers && !told.seen()) {
    decline();
    return std::nullopt;
  }
  if (told.seen() && ours_) {
    is_seen_ = true;
    ours_->forget_descriptor();
  }
  if (!offers || theirs_) return std::nullopt;
  if (declined_) return wire::Memory();
  try {
    theirs_ = std::make_shared<const Theirs>(told);
  } catch (const Error&) {
    return decline();
  }
  wire::Memory answer = ours_ ? wire::Memory() : make();
  answer.set_seen(ours_ != nullptr);
  return answer;
}

std::optional<zmq::message_t> LinkMemory::put(std::string_view chunk) {
  if (!is_seen_ || !theirs_ || chunk.size() > kLocalChunkBytes) return std::nullopt;
  for (std::size_t slot = 0; slot < kMemorySlots; ++slot) {
    if (theirs_->released(slot) != filled_[slot]) continue;
    if (!ours_->fill(slot, chunk)) return std::nullopt;
    ++filled_[slot];
    return place_of(slot, chunk.size());
  }
  return std::nullopt;
}

bool LinkMemory::take(std::vector<zmq::message_t>& parts) {
  if (parts.size() != 3 || parts[1].size() != 0 || parts[2].size() != kPlaceBytes || !theirs_ || !ours_) return false;
  const std::size_t slot = number_in(parts[2], 0);
  const std::size_t size = number_in(parts[2], 4);
  if (slot >= kMemorySlots || size > kLocalChunkBytes) return false;
  parts[1].rebuild(theirs_->slot(slot), size, &Lent::done, new Lent{theirs_, ours_, slot});
  parts.pop_back();
  return true;
}

}  // namespace fiona::host
