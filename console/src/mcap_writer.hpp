#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include <google/protobuf/descriptor.pb.h>

namespace fiona::console {

/// Writes a file of messages, each with its time and the schema of its type: MCAP, version 0 (https://mcap.dev/spec),
/// as other tools read it. Chunks are not compressed. Each is in the file once it is full, has a second of messages, or
/// is flushed: what was written until then is readable though the writer is killed. All functions throw Error (Failed)
/// if the file cannot be written.
class McapWriter {
 public:
  using Channel = std::uint16_t;
  struct Message {
    Channel channel = 0;
    std::uint32_t sequence = 0;
    std::uint64_t logged_ns = 0;     ///< when it has come
    std::uint64_t published_ns = 0;  ///< when it was true
    std::string_view data{};         ///< the object, as protobuf writes it
  };

  /// Throws Error too if there is such a file already.
  explicit McapWriter(const std::string& file);
  ~McapWriter();  ///< of a file that is not finished: as if the writer had been killed
  McapWriter(const McapWriter&) = delete;
  McapWriter& operator=(const McapWriter&) = delete;

  /// `type`: the full name of a message in `files`, which have dependencies before their users.
  Channel add_channel(const std::string& topic, const std::string& type,
                      const google::protobuf::FileDescriptorSet& files);
  void write(const Message& message);
  /// Puts what has been written into the file, where a chunk is still open.
  void flush() {
    if (!chunk_.index.empty()) put_chunk();
  }
  /// Writes the index, and closes the file. Nothing else is called after it.
  void finish();

  std::uint64_t messages() const { return messages_; }
  std::uint64_t bytes() const { return written_; }  ///< in the file
  std::uint64_t first_ns() const { return messages_ > 0 ? first_ns_ : 0; }
  std::uint64_t last_ns() const { return last_ns_; }

 private:
  struct Chunk {
    std::string records{};
    std::uint64_t first_ns = 0, last_ns = 0;
    std::map<Channel, std::vector<std::pair<std::uint64_t, std::uint64_t>>> index{};  ///< time, place in `records`
  };

  void define(std::string& in_summary, const std::string& made);
  void put(std::string_view bytes);
  void put_chunk();
  std::string statistics() const;

  const std::string file_;
  int descriptor_ = -1;
  std::uint64_t written_ = 0;
  std::uint64_t messages_ = 0;
  std::uint64_t first_ns_ = 0, last_ns_ = 0;
  std::map<Channel, std::uint64_t> messages_of_;
  std::map<std::string, std::uint16_t> schemas_;  ///< by type and files
  std::string schema_records_, channel_records_;  ///< for the summary
  std::string chunk_index_;                       ///< records
  std::uint32_t chunks_ = 0;
  Chunk chunk_;
};

}  // namespace fiona::console
