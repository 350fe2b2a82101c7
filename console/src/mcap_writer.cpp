#include "mcap_writer.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fmt/format.h>
#include <zlib.h>
#include <fiona/error.hpp>

namespace fiona::console {
namespace {

// The numbers are those of the specification's records.
enum class Op : std::uint8_t {
  Header = 0x01,
  Footer = 0x02,
  Schema = 0x03,
  Channel = 0x04,
  Message = 0x05,
  Chunk = 0x06,
  MessageIndex = 0x07,
  ChunkIndex = 0x08,
  Statistics = 0x0B,
  SummaryOffset = 0x0E,
  DataEnd = 0x0F,
};

constexpr std::string_view kMagic{"\x89MCAP0\r\n", 8};
constexpr std::size_t kFullChunk_bytes = 1024 * 1024;
constexpr std::uint64_t kLongestChunk_ns = 1'000'000'000;

/// Little endian, as all numbers of the format.
template <class T>
void add(std::string& to, T value) {
  for (std::size_t i = 0; i < sizeof(T); ++i) to.push_back(static_cast<char>(value >> (8 * i)));
}

void add_text(std::string& to, std::string_view text) {
  add(to, static_cast<std::uint32_t>(text.size()));
  to += text;
}

void add_record(std::string& to, Op op, std::string_view content) {
  to.push_back(static_cast<char>(op));
  add(to, std::uint64_t{content.size()});
  to += content;
}

std::string record(Op op, std::string_view content) {
  std::string whole;
  add_record(whole, op, content);
  return whole;
}

std::uint32_t checksum(std::string_view bytes) {
  return static_cast<std::uint32_t>(
      ::crc32_z(0, reinterpret_cast<const Bytef*>(bytes.data()), static_cast<z_size_t>(bytes.size())));
}

[[noreturn]] void refuse(const std::string& file, const std::string& what, const std::string& next) {
  throw Error(ErrorCode::Failed, {.what = what, .where = file, .next = next});
}

}  // namespace

McapWriter::McapWriter(const std::string& file)
    : file_(file), descriptor_(::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666)) {
  if (descriptor_ < 0 && errno == EEXIST) refuse(file, "there is such a file already", "give it another name");
  if (descriptor_ < 0)
    refuse(file, fmt::format("the file cannot be made: {}", std::strerror(errno)), "see whether its folder is there");
  std::string header;
  add_text(header, "");  // no profile: any types
  add_text(header, "fiona " FIONA_VERSION);
  put(std::string(kMagic) + record(Op::Header, header));
}

McapWriter::~McapWriter() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void McapWriter::put(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t size = ::write(descriptor_, bytes.data(), bytes.size());
    if (size < 0 && errno == EINTR) continue;
    if (size < 0) {
      refuse(file_, fmt::format("the file cannot be written: {}", std::strerror(errno)),
             "what was written before is there; see whether the disk is full: df -h");
    }
    written_ += static_cast<std::uint64_t>(size);
    bytes.remove_prefix(static_cast<std::size_t>(size));
  }
}

McapWriter::Channel McapWriter::add_channel(const std::string& topic, const std::string& type,
                                            const google::protobuf::FileDescriptorSet& files) {
  const std::string described = files.SerializeAsString();
  auto [schema, is_new] =
      schemas_.try_emplace(type + '\n' + described, static_cast<std::uint16_t>(schemas_.size() + 1));
  if (is_new) {
    std::string content;
    add(content, schema->second);
    add_text(content, type);
    add_text(content, "protobuf");
    add_text(content, described);
    define(schema_records_, record(Op::Schema, content));
  }
  const auto channel = static_cast<Channel>(messages_of_.size());
  messages_of_[channel] = 0;
  std::string content;
  add(content, channel);
  add(content, schema->second);
  add_text(content, topic);
  add_text(content, "protobuf");
  add(content, std::uint32_t{0});  // no metadata
  define(channel_records_, record(Op::Channel, content));
  return channel;
}

/// In the chunk, ahead of what needs it, and once more in the summary.
void McapWriter::define(std::string& in_summary, const std::string& made) {
  chunk_.records += made;
  in_summary += made;
}

void McapWriter::write(const Message& message) {
  if (chunk_.index.empty()) chunk_.first_ns = chunk_.last_ns = message.logged_ns;
  chunk_.first_ns = std::min(chunk_.first_ns, message.logged_ns);
  chunk_.last_ns = std::max(chunk_.last_ns, message.logged_ns);
  chunk_.index[message.channel].emplace_back(message.logged_ns, chunk_.records.size());
  std::string head;
  add(head, message.channel);
  add(head, message.sequence);
  add(head, message.logged_ns);
  add(head, message.published_ns);
  chunk_.records.push_back(static_cast<char>(Op::Message));
  add(chunk_.records, std::uint64_t{head.size() + message.data.size()});
  chunk_.records += head;
  chunk_.records += message.data;
  first_ns_ = messages_ == 0 ? message.logged_ns : std::min(first_ns_, message.logged_ns);
  last_ns_ = std::max(last_ns_, message.logged_ns);
  ++messages_;
  ++messages_of_[message.channel];
  if (chunk_.records.size() >= kFullChunk_bytes || chunk_.last_ns - chunk_.first_ns >= kLongestChunk_ns) put_chunk();
}

void McapWriter::put_chunk() {
  if (chunk_.records.empty()) return;
  const Chunk chunk = std::exchange(chunk_, {});
  const std::uint64_t begin = written_;
  std::string content;
  add(content, chunk.first_ns);
  add(content, chunk.last_ns);
  add(content, std::uint64_t{chunk.records.size()});
  add(content, checksum(chunk.records));
  add_text(content, "");  // as it is
  add(content, std::uint64_t{chunk.records.size()});
  content += chunk.records;
  std::string made = record(Op::Chunk, content);
  const std::uint64_t size = made.size();
  std::string places;  // of each channel's index
  for (const auto& [channel, entries] : chunk.index) {
    add(places, channel);
    add(places, begin + made.size());
    std::string times;
    for (const auto& [time_ns, place] : entries) {
      add(times, time_ns);
      add(times, place);
    }
    std::string index;
    add(index, channel);
    add_text(index, times);
    add_record(made, Op::MessageIndex, index);
  }
  put(made);
  std::string entry;
  add(entry, chunk.first_ns);
  add(entry, chunk.last_ns);
  add(entry, begin);
  add(entry, size);
  add_text(entry, places);
  add(entry, std::uint64_t{made.size() - size});
  add_text(entry, "");
  add(entry, std::uint64_t{chunk.records.size()});
  add(entry, std::uint64_t{chunk.records.size()});
  add_record(chunk_index_, Op::ChunkIndex, entry);
  ++chunks_;
}

std::string McapWriter::statistics() const {
  std::string content;
  add(content, messages_);
  add(content, static_cast<std::uint16_t>(schemas_.size()));
  add(content, static_cast<std::uint32_t>(messages_of_.size()));
  add(content, std::uint32_t{0});  // attachments
  add(content, std::uint32_t{0});  // metadata
  add(content, chunks_);
  add(content, first_ns_);
  add(content, last_ns_);
  std::string counts;
  for (const auto& [channel, count] : messages_of_) {
    add(counts, channel);
    add(counts, count);
  }
  add_text(content, counts);
  return record(Op::Statistics, content);
}

void McapWriter::finish() {
  put_chunk();
  std::string end;
  add(end, std::uint32_t{0});  // no checksum of all: each chunk has its own
  put(record(Op::DataEnd, end));
  const std::uint64_t begin = written_;
  std::string summary, offsets;
  const auto add_group = [&](Op op, const std::string& records) {
    if (records.empty()) return;
    std::string offset(1, static_cast<char>(op));
    add(offset, begin + summary.size());
    add(offset, std::uint64_t{records.size()});
    add_record(offsets, Op::SummaryOffset, offset);
    summary += records;
  };
  add_group(Op::Schema, schema_records_);
  add_group(Op::Channel, channel_records_);
  add_group(Op::Statistics, statistics());
  add_group(Op::ChunkIndex, chunk_index_);
  const std::uint64_t offsets_begin = begin + summary.size();
  summary += offsets;
  summary.push_back(static_cast<char>(Op::Footer));
  add(summary, std::uint64_t{8 + 8 + 4});
  add(summary, begin);
  add(summary, offsets_begin);
  add(summary, checksum(summary));
  put(summary + std::string(kMagic));
  const int descriptor = std::exchange(descriptor_, -1);
  if (::fsync(descriptor) != 0 && errno != EINVAL) {
    const std::string why = std::strerror(errno);
    ::close(descriptor);
    refuse(file_, "the file cannot be written: " + why, "see whether the disk is full: df -h");
  }
  ::close(descriptor);
}

}  // namespace fiona::console
