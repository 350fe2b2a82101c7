#include "link_message.hpp"

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/zero_copy_stream.h>

#include <algorithm>
#include <cstring>
#include <iterator>
#include <mutex>
#include <new>
#include <set>
#include <string>
#include <utility>

#include "fiona/readable_text.hpp"

namespace fiona::host {
namespace {

/// Blocks of at least this size are made in the size of the largest that is kept.
constexpr std::size_t kPooledFrom = kBlockBytes / 2;
/// Of a chunk's bytes, those that are copied into its record.
constexpr std::size_t kInsideBytes = 4096;
/// A string of so many bytes is sent from where it lies, as a chunk of its own; where there are more of them than an
/// object may have chunks (`most_chunks`), one of this part of a chunk.
constexpr std::size_t kAliasFrom = 128 * 1024;
constexpr std::size_t kAliasFrom_ofChunk = 4;
/// 4 MiB for each process that sends large messages.
constexpr std::size_t kKeptBlocks = 16;
constexpr std::size_t kMostReason = 4096;

/// Blocks that wait to be used again, of this process.
class Shelf {
 public:
  ~Shelf() {
    for (auto* block : idle_) ::operator delete(block);
  }
  std::uint8_t* take() {
    {
      const std::lock_guard lock(mutex_);
      if (!idle_.empty()) {
        auto* block = idle_.back();
        idle_.pop_back();
        return block;
      }
    }
    return static_cast<std::uint8_t*>(::operator new(kBlockBytes));
  }
  void put_back(std::uint8_t* block) {
    {
      const std::lock_guard lock(mutex_);
      if (idle_.size() < kKeptBlocks) return idle_.push_back(block);
    }
    ::operator delete(block);
  }

 private:
  std::mutex mutex_;
  std::vector<std::uint8_t*> idle_;
};

Shelf& shelf() {
  static Shelf one;
  return one;
}

bool is_pooled(std::size_t size) { return size >= kPooledFrom && size <= kBlockBytes; }

void write_length(std::uint8_t* out, std::size_t length) {
  for (int i = 0; i < 4; ++i) out[i] = static_cast<std::uint8_t>(length >> (8 * i));
}

std::size_t read_length(const std::uint8_t* in) {
  return in[0] | in[1] << 8 | in[2] << 16 | static_cast<std::size_t>(in[3]) << 24;
}

std::string_view text_of(const zmq::message_t& message) {
  return {static_cast<const char*>(message.data()), message.size()};
}

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
    : data_(is_pooled(size) ? shelf().take() : static_cast<std::uint8_t*>(::operator new(size))),
      size_(size),
      capacity_(size) {}

Block::Block(Block&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)),
      size_(std::exchange(other.size_, 0)),
      capacity_(std::exchange(other.capacity_, 0)) {}

Block& Block::operator=(Block&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(size_, other.size_);
  std::swap(capacity_, other.capacity_);
  return *this;
}

Block::~Block() {
  if (!data_) return;
  is_pooled(capacity_) ? shelf().put_back(data_) : ::operator delete(data_);
}

std::uint8_t* Block::extend(std::size_t more, std::size_t capacity) {
  const std::size_t size = size_ + more;
  if (size > capacity_) {
    Block grown(std::max(size, capacity));
    std::memcpy(grown.data_, data_, size_);
    grown.size_ = size_;
    *this = std::move(grown);
  }
  return data_ + std::exchange(size_, size);
}

/// Takes what protobuf writes, in order: long strings as they lie in the object, the rest in blocks.
class Payload::Writer final : public google::protobuf::io::ZeroCopyOutputStream {
 public:
  Writer(std::vector<Block>& blocks, std::size_t alias_from) : blocks_(blocks), alias_from_(alias_from) {}

  bool AllowsAliasing() const override { return true; }
  bool WriteAliasedRaw(const void* data, int size) override {
    std::string_view rest(static_cast<const char*>(data), static_cast<std::size_t>(size));
    if (rest.size() >= alias_from_) {
      end_own();
      segments_.push_back(rest);
      shown_ += rest.size();
      return true;
    }
    while (!rest.empty()) {
      void* to = nullptr;
      int room = 0;
      Next(&to, &room);
      const std::size_t part = std::min(rest.size(), static_cast<std::size_t>(room));
      std::memcpy(to, rest.data(), part);
      BackUp(room - static_cast<int>(part));
      rest.remove_prefix(part);
    }
    return true;
  }
  // Protobuf copies what fits into the room that it has been given: the first block is small, so that a long string
  // does not.
  bool Next(void** data, int* size) override {
    if (blocks_.empty() || used_ == blocks_.back().size()) {
      end_own();
      blocks_.emplace_back(blocks_.empty() ? kInsideBytes : kBlockBytes);
      begin_ = used_ = 0;
    }
    *data = blocks_.back().data() + used_;
    *size = static_cast<int>(blocks_.back().size() - used_);
    used_ = blocks_.back().size();
    return true;
  }
  void BackUp(int count) override { used_ -= static_cast<std::size_t>(count); }
  std::int64_t ByteCount() const override { return static_cast<std::int64_t>(shown_ + used_ - begin_); }

  std::vector<std::string_view> take() {
    end_own();
    return std::move(segments_);
  }

 private:
  void end_own() {
    if (used_ == begin_) return;
    segments_.emplace_back(reinterpret_cast<const char*>(blocks_.back().data()) + begin_, used_ - begin_);
    shown_ += used_ - begin_;
    begin_ = used_;
  }

  std::vector<Block>& blocks_;
  const std::size_t alias_from_;
  std::vector<std::string_view> segments_;
  std::size_t shown_ = 0;  ///< bytes of the segments
  std::size_t begin_ = 0;  ///< in the last block: what is in no segment yet
  std::size_t used_ = 0;
};

Payload::Payload(std::shared_ptr<const Object> object, std::size_t chunk)
    : object_(std::move(object)), chunk_(chunk), size_(object_->ByteSizeLong()) {
  write(kAliasFrom);
  if (chunks_.size() <= most_chunks(size_, chunk_)) return;
  chunks_.clear();
  blocks_.clear();
  write(chunk_ / kAliasFrom_ofChunk);
}

void Payload::write(std::size_t alias_from) {
  Writer writer(blocks_, alias_from);
  {
    google::protobuf::io::CodedOutputStream coded(&writer);
    coded.EnableAliasing(true);
    object_->SerializeWithCachedSizes(&coded);
  }
  cut(writer.take());
}

/// Few bytes go inside the record of the chunk behind them.
void Payload::cut(const std::vector<std::string_view>& segments) {
  std::string inside;
  for (std::string_view rest : segments) {
    if (inside.size() + rest.size() <= kInsideBytes) {
      inside += rest;
      continue;
    }
    while (!rest.empty()) {
      const std::string_view beside = rest.substr(0, chunk_ - inside.size());
      rest.remove_prefix(beside.size());
      chunks_.push_back({std::exchange(inside, {}), beside});
    }
  }
  if (!inside.empty()) chunks_.push_back({std::move(inside), {}});
}

/// In whole chunks, whatever pieces it has come in: where it goes next there may be fewer.
Payload::Payload(const ObjectBytes& object) : chunk_(kChunkBytes), size_(object.size()) {
  std::vector<std::string_view> copies;
  for (std::size_t at = 0; at < size_; at += chunk_) {
    const Block& copy = blocks_.emplace_back(std::min(size_ - at, chunk_));
    copies.emplace_back(reinterpret_cast<const char*>(copy.data()), copy.size());
  }
  std::size_t at = 0;
  object.each_piece([&](std::string_view piece) {
    while (!piece.empty()) {
      Block& copy = blocks_[at / chunk_];
      const std::size_t part = std::min(piece.size(), copy.size() - at % chunk_);
      std::memcpy(copy.data() + at % chunk_, piece.data(), part);
      piece.remove_prefix(part);
      at += part;
    }
  });
  cut(copies);
}

namespace {

/// All but the object: its place is returned.
std::uint8_t* begin_record(std::uint8_t* to, const wire::Frame& frame, std::size_t object_size) {
  write_length(to, static_cast<std::size_t>(frame.GetCachedSize()));
  write_length(to + 4, object_size);
  return frame.SerializeWithCachedSizesToArray(to + kRecordHead);
}

}  // namespace

std::string told_reason(std::string_view reason) { return readable_text(reason, kMostReason); }

std::size_t record_size(const wire::Frame& frame, std::size_t object_size) {
  return kRecordHead + frame.ByteSizeLong() + object_size;
}

void write_record(std::uint8_t* to, const wire::Frame& frame, const Object* object, std::size_t object_size) {
  std::uint8_t* const end = begin_record(to, frame, object_size);
  if (object) object->SerializeWithCachedSizesToArray(end);
}

Block make_record(const wire::Frame& frame, const Object* object, std::size_t object_size) {
  Block block(record_size(frame, object_size));
  write_record(block.data(), frame, object, object_size);
  return block;
}

Block make_record(const wire::Frame& frame, const ObjectBytes& object) {
  Block block(record_size(frame, object.size()));
  std::uint8_t* end = begin_record(block.data(), frame, object.size());
  object.each_piece([&end](std::string_view piece) { end = std::copy(piece.begin(), piece.end(), end); });
  return block;
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

namespace {

/// The frame of a small object of a push, written as protobuf writes it, as most frames are: read without its parser,
/// which costs a sixth of all that receiving the object does. False: it is another one, or written in another way.
bool read_object_frame(std::string_view bytes, wire::Frame& frame) {
  enum Type : std::uint32_t { Varint = 0, Fixed64 = 1, Delimited = 2 };  // protobuf's encoding, "Message structure"
  constexpr auto tag = [](std::uint32_t field, Type type) { return field << 3 | type; };
  google::protobuf::io::CodedInputStream in(reinterpret_cast<const std::uint8_t*>(bytes.data()),
                                            static_cast<int>(bytes.size()));
  std::uint64_t wire = 0;
  std::uint64_t sequence = 0;
  std::uint64_t origin_ns = 0;
  std::uint64_t lane = 0;
  int size = 0;
  if (!in.ExpectTag(tag(wire::Frame::kWireFieldNumber, Varint)) || !in.ReadVarint64(&wire)) return false;
  if (!in.ExpectTag(tag(wire::Frame::kObjectFieldNumber, Delimited))) return false;
  const int begin = in.CurrentPosition() + 1;  // it is as short as its length is
  if (!in.ReadVarintSizeAsInt(&size) || in.CurrentPosition() != begin) return false;
  if (!in.ExpectTag(tag(wire::Object::kSequenceFieldNumber, Varint)) || !in.ReadVarint64(&sequence)) return false;
  if (!in.ExpectTag(tag(wire::Object::kOriginNsFieldNumber, Fixed64)) || !in.ReadLittleEndian64(&origin_ns))
    return false;
  if (in.CurrentPosition() - begin != size) return false;
  if (!in.ExpectTag(tag(wire::Frame::kLaneFieldNumber, Varint)) || !in.ReadVarint64(&lane)) return false;
  if (in.CurrentPosition() != static_cast<int>(bytes.size())) return false;
  frame.set_wire(wire);
  frame.mutable_object()->set_sequence(sequence);
  frame.mutable_object()->set_origin_ns(static_cast<std::int64_t>(origin_ns));
  frame.set_lane(lane);
  return true;
}

}  // namespace

bool is_of_link(const wire::Frame& frame) {
  switch (frame.what_case()) {
    case wire::Frame::kCredit:
    case wire::Frame::kHello:
    case wire::Frame::kChallenge:
    case wire::Frame::kProof:
    case wire::Frame::kHost:
    case wire::Frame::kMemory: return true;
    default: return false;
  }
}

/// Everything from the network is checked before use: lengths and frames here, then the wire's own rules.
bool FrameReader::read(std::vector<zmq::message_t>& parts, Receiver& receiver, bool lent) {
  if (parts.empty() || parts.size() > 2) return false;
  lent_ = lent;
  std::string_view rest = text_of(parts.front());
  scratch_->arena.Reset();
  auto& other = *google::protobuf::Arena::CreateMessage<wire::Frame>(&scratch_->arena);
  do {
    if (rest.size() < kRecordHead) return false;
    const auto* head = reinterpret_cast<const std::uint8_t*>(rest.data());
    const std::size_t frame_size = read_length(head);
    const std::size_t object_size = read_length(head + 4);
    rest.remove_prefix(kRecordHead);
    if (frame_size > kMostFrame) return false;
    if (frame_size > rest.size() || object_size > rest.size() - frame_size) return false;
    const bool of_object = read_object_frame(rest.substr(0, frame_size), scratch_->of_object);
    if (!of_object && !other.ParseFromArray(rest.data(), static_cast<int>(frame_size))) return false;
    const wire::Frame& frame = of_object ? scratch_->of_object : other;
    if (static_cast<std::size_t>(frame.also_size()) > kMostAlso) return false;
    if (is_of_link(frame) && (frame.wire() != 0 || frame.also_size() > 0)) return false;
    const auto inside = rest.substr(frame_size, object_size);
    rest.remove_prefix(frame_size + object_size);
    zmq::message_t* beside = rest.empty() && parts.size() == 2 ? &parts.back() : nullptr;
    if (!take(frame, inside, beside, receiver)) return false;
  } while (!rest.empty());
  return true;
}

bool FrameReader::take(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver) {
  if (frame.has_more()) return go_on(frame, inside, beside, receiver);
  const std::size_t here = inside.size() + (beside ? beside->size() : 0);
  if (frame.size() > here) return begin(frame, inside, beside, receiver);
  if (frame.size() != 0 && frame.size() != here) return false;
  if (!beside || inside.empty()) {
    receiver.on_frame(frame, beside ? text_of(*beside) : inside);
    return true;
  }
  Assembly both;
  both.frame.set_size(here);
  if (!add(both, inside, beside)) return false;
  receiver.on_frame(frame, ObjectBytes(both.pieces, here));
  return true;
}

/// Whether there were any.
template <class F>
bool FrameReader::drop(Receiver& receiver, F which) {
  return std::erase_if(assemblies_, [&](const auto& one) {
           const bool goes = which(one);
           if (goes) receiver.on_dropped(one.second.frame);
           return goes;
         }) > 0;
}

bool FrameReader::begin(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver) {
  if (frame.size() > kMaxObject) return false;
  const auto is_refused = [&](auto which) {
    if (!drop(receiver, which)) return false;
    receiver.on_dropped(frame);
    return true;
  };
  // A wire's objects come one after the other: a second one before the first has ended is nobody's.
  if (is_refused([&](const auto& one) { return one.first == frame.wire(); })) return false;
  drop_ended(receiver);
  const auto wire = receiver.accepts(frame);
  if (!wire) return true;
  // Nor does it help to name another's wire first.
  if (is_refused([&](const auto& one) { return one.second.accepted_for == *wire; })) return false;
  Assembly assembly;
  assembly.frame = frame;
  assembly.accepted_for = *wire;
  if (!add(assembly, inside, beside)) return receiver.on_dropped(frame), false;
  assemblies_.emplace(frame.wire(), std::move(assembly));
  return true;
}

/// An object whose wires have ended since it began, and whose end may never come, is one that is not accepted.
void FrameReader::drop_ended(Receiver& receiver) {
  std::set<std::uint64_t> wires;
  for (auto it = assemblies_.begin(); it != assemblies_.end();) {
    const auto wire = receiver.accepts(it->second.frame);
    const bool goes_on = wire && wires.insert(*wire).second;
    if (wire && !goes_on) receiver.on_dropped(it->second.frame);
    if (goes_on) it->second.accepted_for = *wire;
    it = goes_on ? std::next(it) : assemblies_.erase(it);
  }
}

bool FrameReader::go_on(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver) {
  const auto found = assemblies_.find(frame.wire());
  if (found == assemblies_.end()) return true;  // of an object that is not accepted
  if (!add(found->second, inside, beside)) {
    receiver.on_dropped(found->second.frame);
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
  const std::size_t size = inside.size() + (beside ? beside->size() : 0);
  // A peer that sent it byte by byte would make each byte cost a message.
  if (size == 0 || size > chunk_ || ++assembly.messages > most_chunks(assembly.frame.size(), chunk_)) return false;
  if (size > assembly.frame.size() - assembly.received) return false;
  assembly.received += size;
  if (!inside.empty()) assembly.pieces.emplace_back(inside.data(), inside.size());
  if (!beside) return true;
  zmq::message_t piece = std::move(*beside);
  const bool is_kept = assembly.received < assembly.frame.size();
  if (lent_ && is_kept) piece = zmq::message_t(piece.data(), piece.size());
  assembly.pieces.push_back(std::move(piece));
  return true;
}

}  // namespace fiona::host
