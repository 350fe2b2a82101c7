#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>
#include <zmq.hpp>

#include <google/protobuf/arena.h>

#include "fiona/service.hpp"
#include "fiona/wire.pb.h"

namespace fiona::host {

/// The most of an object that one ZeroMQ message carries between hosts (docs/architecture.md, The way of a message):
/// what a large message may put before a small one. Between processes of one host an image of 1 MiB takes less time
/// than a chunk does over a network, and each chunk wakes a thread at both ends.
inline constexpr std::size_t kChunkBytes = 512 * 1024;
inline constexpr std::size_t kLocalChunkBytes = 1024 * 1024 + 16 * 1024;
/// The largest object that goes over a link.
inline constexpr std::size_t kMaxObject = 64 * 1024 * 1024;
/// An object up to this size travels inside its record and may share a ZeroMQ message with others.
inline constexpr std::size_t kInlineBytes = 16 * 1024;
/// Wires that one frame is for beside its own, at most: those of a push port to one process share what crosses.
inline constexpr std::size_t kMostAlso = 4096;
/// A frame's own bytes at most, whatever object it carries: who passes it on puts a whole chunk beside it.
inline constexpr std::size_t kMostFrame = 48 * 1024;
/// What a link or wire of another version is told.
inline constexpr const char* kNotGranted = "the wire was not granted";
inline constexpr const char* kUnknownVersion = "unknown protocol version: this side speaks 1";
/// A record begins with the lengths of its frame and of the object's bytes in it, 4 bytes each, little endian.
inline constexpr std::size_t kRecordHead = 8;

/// What small messages are put together in, up to so much of them, and what of an object does not lie in one piece.
inline constexpr std::size_t kBlockBytes = 256 * 1024;

/// Bytes of their own that can be handed to ZeroMQ. Those of this size are used again: a fresh one costs more in page
/// faults than the copying into it.
class Block {
 public:
  Block() = default;
  explicit Block(std::size_t size);
  Block(Block&& other) noexcept;
  Block& operator=(Block&& other) noexcept;
  ~Block();

  std::uint8_t* data() { return data_; }
  const std::uint8_t* data() const { return data_; }
  std::size_t size() const { return size_; }
  /// Room for `more` bytes behind the others. Grows to `capacity` or more at once, so that many are added for few
  /// allocations.
  std::uint8_t* extend(std::size_t more, std::size_t capacity);

 private:
  std::uint8_t* data_ = nullptr;
  std::size_t size_ = 0;
  std::size_t capacity_ = 0;
};

/// An object as it has come, in one piece or in several, to be parsed.
class ObjectBytes {
 public:
  ObjectBytes() = default;
  ObjectBytes(std::string_view whole) : whole_(whole), size_(whole.size()) {}
  ObjectBytes(const std::vector<zmq::message_t>& pieces, std::size_t size) : pieces_(&pieces), size_(size) {}

  std::size_t size() const { return size_; }
  bool parse_into(Object& object) const;
  std::string to_string() const;
  /// Calls `take` with each piece, in order.
  template <class F>
  void each_piece(F take) const {
    if (!pieces_) return take(whole_);
    for (const auto& piece : *pieces_) take(std::string_view(static_cast<const char*>(piece.data()), piece.size()));
  }

 private:
  std::string_view whole_;
  const std::vector<zmq::message_t>* pieces_ = nullptr;
  std::size_t size_ = 0;
};

/// A serialised object that is too large for its record, in chunks that are read by the links to all its receivers. Its
/// long strings and bytes are not copied: they are sent from where the object has them.
class Payload {
 public:
  /// What one message carries: a few bytes inside its record, the rest beside it. A chunk together at most.
  struct Chunk {
    std::string inside;
    std::string_view beside;
    std::size_t size() const { return inside.size() + beside.size(); }
  };

  explicit Payload(std::shared_ptr<const Object> object, std::size_t chunk = kChunkBytes);
  /// As it has come: to be passed on.
  explicit Payload(const ObjectBytes& object);
  std::size_t size() const { return size_; }
  std::size_t chunk() const { return chunk_; }
  const std::vector<Chunk>& chunks() const { return chunks_; }

 private:
  class Writer;
  void write(std::size_t alias_from);
  void cut(const std::vector<std::string_view>& segments);

  const std::shared_ptr<const Object> object_;  ///< whose strings the chunks may show
  const std::size_t chunk_;
  std::size_t size_ = 0;
  std::vector<Block> blocks_;
  std::vector<Chunk> chunks_;
};

/// Of the link itself or of the two hosts: who has only a wire must not speak so to whoever is at its other end.
bool is_of_link(const wire::Frame& frame);
/// Why, as a peer is told it: a sentence of 4 KiB at most.
std::string told_reason(std::string_view reason);
/// A record: head, frame, and the object's bytes if it has any that travel inside. Its size, and writing it where there
/// is room for so much: between the two the frame and the object must stay as they are.
std::size_t record_size(const wire::Frame& frame, std::size_t object_size);
void write_record(std::uint8_t* to, const wire::Frame& frame, const Object* object, std::size_t object_size);
Block make_record(const wire::Frame& frame, const Object* object, std::size_t object_size);
Block make_record(const wire::Frame& frame, const ObjectBytes& object);
/// How many messages an object may come in that is too large for one.
constexpr std::size_t most_chunks(std::size_t object, std::size_t chunk = kChunkBytes) {
  return 8 * (object / chunk + 1);
}

/// Puts together what one peer sends: records out of messages, and objects out of chunks. What it holds is bounded: one
/// object for each wire that is the peer's, of at most `kMaxObject`, and never more of it than has come.
class FrameReader {
 public:
  class Receiver {
   public:
    virtual ~Receiver() = default;
    /// The wire of this peer's that an object in several chunks is for; none: it is not to be put together.
    virtual std::optional<std::uint64_t> accepts(const wire::Frame& frame) = 0;
    virtual void on_frame(const wire::Frame& frame, const ObjectBytes& object) = 0;
    /// An object that was accepted has been dropped before it was whole.
    virtual void on_dropped(const wire::Frame&) {}
  };

  /// Chunks are of this size at most.
  explicit FrameReader(std::size_t chunk = kChunkBytes) : chunk_(chunk) {}

  /// One message's parts. `lent`: the second is the sender's memory, and kept no longer than it takes to read this.
  /// False: it is garbled; what was whole before the fault has been passed on.
  bool read(std::vector<zmq::message_t>& parts, Receiver& receiver, bool lent = false);
  /// Objects of which a part is still to come.
  std::size_t unfinished() const { return assemblies_.size(); }

 private:
  struct Assembly {
    wire::Frame frame;
    std::uint64_t accepted_for = 0;  ///< whatever wire the frame names first
    std::size_t received = 0;
    std::size_t messages = 0;
    std::vector<zmq::message_t> pieces;
  };
  bool take(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver);
  bool begin(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver);
  template <class F>
  bool drop(Receiver& receiver, F which);
  void drop_ended(Receiver& receiver);
  bool go_on(const wire::Frame& frame, std::string_view inside, zmq::message_t* beside, Receiver& receiver);
  bool add(Assembly& assembly, std::string_view inside, zmq::message_t* beside);

  /// Of the frames of one message: their memory is used again for the next one's.
  struct Scratch {
    alignas(8) char first[1024];
    google::protobuf::Arena arena{first, sizeof first};
    wire::Frame of_object;  ///< in which nothing else is ever set
  };
  const std::size_t chunk_;
  const std::unique_ptr<Scratch> scratch_ = std::make_unique<Scratch>();
  std::unordered_map<std::uint64_t, Assembly> assemblies_;  ///< by the wire that the object's first frame names
  bool lent_ = false;                                       ///< the second part of what is being read
};

}  // namespace fiona::host
