#pragma once

#include <compare>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <queue>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::recording_player {

/// Reads a file of messages in the order of their times: MCAP, version 0 (https://mcap.dev/spec), as any tool has
/// written it: with an index or without, in chunks or not, chunks as they are or compressed (lz4, zstd), or cut off
/// anywhere. What it holds in memory is bounded by the chunks that cover one time. Errors name the file and the byte.
class McapReader {
 public:
  struct Channel {
    std::string topic;
    std::string encoding;         ///< of its messages: "protobuf", "cdr", "json"
    std::string type;             ///< the name of its schema; empty: it has none
    std::string schema_encoding;  ///< "protobuf": a serialised FileDescriptorSet
    std::string schema;
  };
  using ChannelId = std::uint16_t;
  struct Message {
    ChannelId channel = 0;
    std::uint64_t logged_ns = 0;     ///< when it had come
    std::uint64_t published_ns = 0;  ///< when it was true
    std::string_view data{};         ///< until the next call
  };

  /// Looks at each record's head, and into the chunks only where nothing else tells the channels. Throws Error:
  /// NotFound where there is no such file, else Failed.
  explicit McapReader(const std::filesystem::path& file);
  ~McapReader();
  McapReader(const McapReader&) = delete;
  McapReader& operator=(const McapReader&) = delete;

  const std::map<ChannelId, Channel>& channels() const { return channels_; }
  /// It ends within a record, or before its end was written: all that was whole is read.
  bool is_cut() const { return !ended_; }
  /// Records that could not be read when it was opened, beside those that `next` tells.
  std::uint64_t damaged() const { return damaged_; }
  /// Of all its messages, as its chunks say; 0 where it has none.
  std::uint64_t first_ns() const;
  std::uint64_t last_ns() const;

  /// From here on only messages of these channels, of `from_ns` or later. Before the first `next`.
  void select(std::set<ChannelId> channels, std::uint64_t from_ns);
  enum class Next { Message, Later, End };
  /// The next message; or Later, if a chunk had to be read first, which takes some milliseconds: ask again. Throws
  /// Error (Failed) where a chunk cannot be read: the call after it goes on behind that.
  Next next(Message& message);

 private:
  /// A chunk, or messages outside of chunks that follow each other in the file.
  struct Region {
    std::uint64_t at = 0;    ///< of its records
    std::uint64_t size = 0;  ///< in the file
    std::uint64_t first_ns = 0, last_ns = 0;
    std::string compression{};
    std::uint64_t unpacked = 0;
    std::uint32_t checksum = 0;  ///< 0: none
    bool is_chunk = false;
    std::vector<ChannelId> indexed{};  ///< what its indexes name; empty: it has none
  };
  struct Loaded {
    std::string records{};
    std::size_t waiting = 0;  ///< messages in it
  };
  struct Waiting {
    std::uint64_t logged_ns = 0;
    std::uint32_t region = 0;
    std::uint32_t at = 0;  ///< of the message, in the region's records
    /// Where times are equal, by region, and as they lie in it.
    auto operator<=>(const Waiting&) const = default;
  };

  void scan();
  void scan_record(std::uint8_t op, std::uint64_t at, std::uint64_t size);
  void add_region(Region region);
  void define_from_chunks();
  void drop_empty_chunks();
  bool is_wanted(const Region& region) const;
  void define(std::uint8_t op, std::string_view content, std::uint64_t at);
  void load(std::uint32_t region);
  void unload(std::uint32_t region);
  std::string records_of(const Region& region) const;
  std::string bytes(std::uint64_t at, std::uint64_t size) const;
  std::string_view head(std::uint64_t at, std::uint64_t size);
  [[noreturn]] void fail(std::uint64_t at, const std::string& what) const;

  const std::filesystem::path file_;
  int descriptor_ = -1;
  std::uint64_t size_ = 0;
  bool data_ended_ = false;  ///< what follows is the summary
  bool has_summary_ = false;
  bool ended_ = false;  ///< its footer was read
  std::uint64_t damaged_ = 0;
  std::string window_;  ///< of the file, so that heads of records cost few calls
  std::uint64_t window_at_ = 0;

  struct Schema {
    std::string type, encoding, data;
  };
  std::map<std::uint16_t, Schema> schemas_;
  std::uint64_t schema_bytes_ = 0;
  std::map<ChannelId, Channel> channels_;

  std::vector<Region> regions_;
  std::uint32_t next_region_ = 0;
  std::optional<std::set<ChannelId>> selected_;
  std::uint64_t from_ns_ = 0;
  std::map<std::uint32_t, Loaded> loaded_;
  std::uint64_t loaded_bytes_ = 0;
  std::priority_queue<Waiting, std::vector<Waiting>, std::greater<>> waiting_;
  std::optional<std::uint32_t> shown_;  ///< whose bytes the last message has
};

}  // namespace fiona::recording_player
