#include "link_message.hpp"

#include <google/protobuf/io/zero_copy_stream.h>

#include <algorithm>
#include <cstring>
#include <mutex>
#include <new>
#include <string>
#include <utility>

namespace fiona::host {
namespace {

/// Blocks of at least this size are made in the size of a chunk, and kept.
constexpr std::size_t kPooledFrom = kChunkBytes / 2;
/// 4 MiB for each process that sends large messages.
constexpr std::size_t kKeptChunks = 16;

/// Chunks that wait to be used again, of this process.
class Shelf {
 public:
  ~Shelf() {
    for (auto* chunk : idle_) ::operator delete(chunk);
  }
  std::uint8_t* take() {
    {
      const std::lock_guard lock(mutex_);
      if (!idle_.empty()) {
        auto* chunk = idle_.back();
        idle_.pop_back();
        return chunk;
      }
    }
    return static_cast<std::uint8_t*>(::operator new(kChunkBytes));
  }
  void put_back(std::uint8_t* chunk) {
    {
      const std::lock_guard lock(mutex_);
      if (idle_.size() < kKeptChunks) return idle_.push_back(chunk);
    }
    ::operator delete(chunk);
  }

 private:
  std::mutex mutex_;
  std::vector<std::uint8_t*> idle_;
};

Shelf& shelf() {
  static Shelf one;
  return one;
}

bool is_pooled(std::size_t size) { return size >= kPooledFrom && size <= kChunkBytes; }

void write_length(std::uint8_t* out, std::size_t length) {
  for (int i = 0; i < 4; ++i) out[i] = static_cast<std::uint8_t>(length >> (8 * i));
}

std::size_t read_length(const std::uint8_t* in) {
  return in[0] | in[1] << 8 | in[2] << 16 | static_cast<std::size_t>(in[3]) << 24;
}

std::string_view text_of(const zmq::message_t& message) { return {static_cast<const char*>(message.data()), message.size()}; }

/// The pieces of an object as one input.
class PiecesInput final : public google::protobuf::io::ZeroCopyInputStream {
 public:
  explicit PiecesInput(const std::vector<zmq::message_t>& pieces) : pieces_(pieces) {}
  bool Next(const void** data, int* size) override {
    while (next_ < pieces_.size() && offset_ == pieces_[next_].size()) {
      ++next_;
      offset_ = 0;
    }
    if (next_ == pieces_.size()) return false;
    *data = static_cast<const char*>(pieces_[next_].data()) + offset_;
    *size = static_cast<int>(pieces_[next_].size() - offset_);
    read_ += *size;
    offset_ = pieces_[next_].size();
    return true;
  }
  void BackUp(int count) override {
    offset_ -= static_cast<std::size_t>(count);
    read_ -= count;
  }
  bool Skip(int count) override {
    const void* data = nullptr;
    for (int size = 0; Next(&data, &size); count -= size) {
      if (size < count) continue;
      BackUp(size - count);
      return true;
    }
    return count == 0;
  }
  std::int64_t ByteCount() const override { return read_; }

 private:
  const std::vector<zmq::message_t>& pieces_;
  std::size_t next_ = 0;
  std::size_t offset_ = 0;
  std::int64_t read_ = 0;
};

}  // namespace

// ---- what is sent ---------------------------------------------------------------------------------------------

Block::Block(std::size_t size)
    : data_(is_pooled(size) ? shelf().take() : static_cast<std::uint8_t*>(::operator new(size))), size_(size) {}

Block::Block(Block&& other) noexcept : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}

Block& Block::operator=(Block&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(size_, other.size_);
  return *this;
}

Block::~Block() {
  if (!data_) return;
  is_pooled(size_) ? shelf().put_back(data_) : ::operator delete(data_);
}

/// Gives protobuf one chunk after the other to write into.
class Payload::Writer final : public google::protobuf::io::ZeroCopyOutputStream {
 public:
  Writer(std::vector<Block>& chunks, std::size_t size) : chunks_(chunks), left_(size) {}
  bool Next(void** data, int* size) override {
    if (left_ == 0) return false;
    Block& chunk = chunks_.emplace_back(std::min(left_, kChunkBytes));
    left_ -= chunk.size();
    *data = chunk.data();
    *size = static_cast<int>(chunk.size());
    return true;
  }
  // The chunks have the object's exact size: what is not used is given back at the very end only, and is nothing.
  void BackUp(int) override {}
  std::int64_t ByteCount() const override { return 0; }

 private:
  std::vector<Block>& chunks_;
  std::size_t left_;
};

Payload::Payload(const Object& object) : size_(object.ByteSizeLong()) {
  Writer writer(chunks_, size_);
  object.SerializePartialToZeroCopyStream(&writer);
}

Payload::Payload(const ObjectBytes& object) : size_(object.size()) {
  object.each_piece([this](std::string_view piece) {
    while (!piece.empty()) {
      Block& chunk = chunks_.emplace_back(std::min(piece.size(), kChunkBytes));
      std::memcpy(chunk.data(), piece.data(), chunk.size());
      piece.remove_prefix(chunk.size());
    }
  });
}

namespace {

/// The record with room for the object at its end.
std::pair<Block, std::uint8_t*> begin_record(const wire::Frame& frame, std::size_t object_size) {
  const std::size_t frame_size = frame.ByteSizeLong();
  Block block(kRecordHead + frame_size + object_size);
  write_length(block.data(), frame_size);
  write_length(block.data() + 4, object_size);
  auto* end = frame.SerializeWithCachedSizesToArray(block.data() + kRecordHead);
  return {std::move(block), end};
}

}  // namespace

Block make_record(const wire::Frame& frame, const Object* object, std::size_t object_size) {
  auto [block, end] = begin_record(frame, object_size);
  if (object) object->SerializeWithCachedSizesToArray(end);
  return std::move(block);
}

Block make_record(const wire::Frame& frame, const ObjectBytes& object) {
  auto [block, end] = begin_record(frame, object.size());
  object.each_piece([&out = end](std::string_view piece) { out = std::copy(piece.begin(), piece.end(), out); });
  return std::move(block);
}

// ---- what is received -----------------------------------------------------------------------------------------

bool ObjectBytes::parse_into(Object& object) const {
  if (!pieces_) return object.ParseFromArray(whole_.data(), static_cast<int>(whole_.size()));
  PiecesInput input(*pieces_);
  return object.ParseFromZeroCopyStream(&input);
}

std::string ObjectBytes::to_string() const {
  std::string text(whole_);
  if (!pieces_) return text;
  text.reserve(size_);
  for (const auto& piece : *pieces_) text += text_of(piece);
  return text;
}

/// Everything from the network is checked before use: lengths here, then protobuf, then the wire's own rules.
bool FrameReader::read(std::vector<zmq::message_t>& parts, Receiver& receiver) {
  if (parts.empty() || parts.size() > 2) return false;
  std::string_view rest = text_of(parts.front());
  do {
    if (rest.size() < kRecordHead) return false;
    const auto* head = reinterpret_cast<const std::uint8_t*>(rest.data());
    const std::size_t frame_size = read_length(head);
    const std::size_t object_size = read_length(head + 4);
    rest.remove_prefix(kRecordHead);
    if (frame_size > rest.size() || object_size > rest.size() - frame_size) return false;
    if (!frame_.ParseFromArray(rest.data(), static_cast<int>(frame_size))) return false;
    const auto inside = rest.substr(frame_size, object_size);
    rest.remove_prefix(frame_size + object_size);
    zmq::message_t* beside = rest.empty() && parts.size() == 2 ? &parts.back() : nullptr;
    if (!take(frame_, inside, beside, receiver)) return false;
  } while (!rest.empty());
  return true;
}

bool FrameReader::take(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver) {
  if (beside && !inside.empty()) return false;
  if (frame.has_more()) return go_on(frame, inside, beside, receiver);
  const std::size_t here = beside ? beside->size() : inside.size();
  if (frame.size() > here) return begin(frame, inside, beside, receiver);
  if (frame.size() != 0 && frame.size() != here) return false;
  receiver.on_frame(frame, beside ? text_of(*beside) : inside);
  return true;
}

bool FrameReader::begin(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver) {
  // A wire's objects come one after the other: a second one before the first has ended is nobody's.
  if (frame.size() > kMaxObject || assemblies_.erase(frame.wire()) > 0) return false;
  if (!receiver.accepts(frame)) return true;
  Assembly assembly;
  assembly.frame = frame;
  if (!add(assembly, inside, beside)) return false;
  assemblies_.emplace(frame.wire(), std::move(assembly));
  return true;
}

bool FrameReader::go_on(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver) {
  const auto found = assemblies_.find(frame.wire());
  if (found == assemblies_.end()) return true;  // of an object that is not accepted
  if (!add(found->second, inside, beside)) {
    assemblies_.erase(found);
    return false;
  }
  if (found->second.received < found->second.frame.size()) return true;
  const Assembly whole = std::move(found->second);
  assemblies_.erase(found);
  receiver.on_frame(whole.frame, ObjectBytes(whole.pieces, whole.received));
  return true;
}

bool FrameReader::add(Assembly& assembly, std::string_view inside, zmq::message_t* beside) {
  zmq::message_t piece = beside ? std::move(*beside) : zmq::message_t(inside.data(), inside.size());
  // Whole chunks and a rest: a peer that sent it byte by byte would make each byte cost a message.
  if (piece.size() != std::min<std::size_t>(chunk_, assembly.frame.size() - assembly.received)) return false;
  assembly.received += piece.size();
  assembly.pieces.push_back(std::move(piece));
  return true;
}

}  // namespace fiona::host
