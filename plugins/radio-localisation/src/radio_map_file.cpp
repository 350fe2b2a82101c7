#include "radio_map_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <bit>
#include <cerrno>
#include <cmath>
#include <concepts>
#include <cstring>
#include <fstream>
#include <string>
#include <system_error>

#include <fiona/error.hpp>

namespace fiona::radio {
namespace {

namespace fs = std::filesystem;

// Layout: magic, u32 version, u64 payload length, u64 checksum of the payload, payload. Numbers are little-endian.
constexpr std::string_view kMagic = "FIONARM\n";
constexpr std::size_t kHeaderBytes = 8 + 4 + 8 + 8;
constexpr std::uintmax_t kMostBytes = 1ull << 30;
constexpr double kPathUnit_m = 0.1;
constexpr int kHighestLevel = 1000;
constexpr double kFarthest_m = 1e7;

/// FNV-1a, 64 bit: finds damage; who may have written the file is the package signature's business.
std::uint64_t checksum(std::string_view bytes) {
  std::uint64_t hash = 0xCBF29CE484222325ull;
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001B3ull;
  return hash;
}

class Writer {
 public:
  template <std::unsigned_integral T>
  void integer(T value) {
    for (std::size_t i = 0; i < sizeof(T); ++i) bytes.push_back(static_cast<char>((value >> (8 * i)) & 0xFF));
  }
  void real(double value) { integer(std::bit_cast<std::uint64_t>(value)); }
  void text(const std::string& value) {
    integer(static_cast<std::uint16_t>(value.size()));
    bytes.append(value, 0, static_cast<std::uint16_t>(value.size()));
  }
  /// Seven bits a byte, lowest first.
  void compact(std::uint32_t value) {
    for (; value >= 0x80; value >>= 7) bytes.push_back(static_cast<char>(value | 0x80));
    bytes.push_back(static_cast<char>(value));
  }
  std::string bytes;
};

class Reader {
 public:
  Reader(std::string_view bytes, const fs::path& file) : bytes_(bytes), file_(file) {}

  template <std::unsigned_integral T>
  T integer() {
    const std::string_view part = take(sizeof(T));
    T value = 0;
    for (std::size_t i = 0; i < sizeof(T); ++i)
      value |= static_cast<T>(T{static_cast<unsigned char>(part[i])} << (8 * i));
    return value;
  }
  double real() { return std::bit_cast<double>(integer<std::uint64_t>()); }
  std::string text() { return std::string(take(integer<std::uint16_t>())); }
  std::uint32_t compact() {
    std::uint32_t value = 0;
    for (int shift = 0; shift < 35; shift += 7) {
      const auto byte = integer<std::uint8_t>();
      value |= static_cast<std::uint32_t>(byte & 0x7F) << shift;
      if (byte < 0x80) return value;
    }
    fail("a number that does not end");
  }
  /// A count of things of which each takes at least `bytes_each`: never more than the rest of the file can hold.
  std::uint32_t count(std::size_t bytes_each) {
    const auto value = integer<std::uint32_t>();
    require(value <= bytes_.size() / bytes_each, "a count beyond the end of the file");
    return value;
  }
  std::string_view take(std::size_t size) {
    require(size <= bytes_.size(), "its end in the middle of a field");
    const std::string_view part = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return part;
  }
  void require(bool holds, const char* otherwise) const {
    if (!holds) fail(otherwise);
  }
  bool at_end() const { return bytes_.empty(); }

  [[noreturn]] void fail(const std::string& found) const {
    throw Error(ErrorCode::Failed,
                {.what = "the radio map is garbled",
                 .where = file_.string(),
                 .expected = "a complete file written by fiona-radiomap",
                 .found = found,
                 .next = "copy the file again, or learn it again: fiona-radiomap learn DIR -o FILE"});
  }

 private:
  std::string_view bytes_;
  fs::path file_;
};

void write_level(Writer& writer, const RadioMap& map, const Level& level) {
  writer.integer(static_cast<std::uint32_t>(level.level));
  writer.real(level.west_m);
  writer.real(level.south_m);
  writer.integer(static_cast<std::uint32_t>(level.columns));
  writer.integer(static_cast<std::uint32_t>(level.rows));
  // Runs of squares without and with radio, in turns.
  std::uint32_t run = 0;
  bool inside = false;
  for (const std::int32_t cell : level.cell_at) {
    if ((cell >= 0) != inside) {
      writer.compact(run);
      run = 0;
      inside = !inside;
    }
    ++run;
  }
  writer.compact(run);
  for (std::uint32_t i = 0; i < level.cell_count; ++i) {
    const double distance = map.cells[level.first_cell + i].path_distance_m / kPathUnit_m;
    writer.integer(static_cast<std::uint8_t>(std::min(255.0, std::round(distance))));
  }
}

void read_level(Reader& reader, RadioMap& map, std::int64_t squares_left) {
  Level level;
  level.level = static_cast<std::int32_t>(reader.integer<std::uint32_t>());
  reader.require(level.level >= -kHighestLevel && level.level <= kHighestLevel, "a level of impossible number");
  reader.require(map.levels.empty() || map.levels.back().level < level.level, "levels that do not ascend");
  level.west_m = reader.real();
  level.south_m = reader.real();
  const std::int64_t columns = reader.integer<std::uint32_t>(), rows = reader.integer<std::uint32_t>();
  reader.require(columns > 0 && rows > 0 && columns <= squares_left && rows <= squares_left / columns &&
                     std::abs(level.west_m) < kFarthest_m && std::abs(level.south_m) < kFarthest_m,
                 "a level of impossible extent");
  level.columns = static_cast<int>(columns);
  level.rows = static_cast<int>(rows);
  level.first_cell = static_cast<std::uint32_t>(map.cells.size());
  const auto squares = static_cast<std::size_t>(columns * rows);
  level.cell_at.reserve(squares);
  for (bool inside = false; level.cell_at.size() < squares; inside = !inside) {
    const std::uint32_t run = reader.compact();
    reader.require(run <= squares - level.cell_at.size(), "more squares than the level has");
    reader.require(run > 0 || level.cell_at.empty(), "an empty run of squares");
    for (std::uint32_t i = 0; i < run; ++i) {
      level.cell_at.push_back(inside ? static_cast<std::int32_t>(level.first_cell + level.cell_count++) : -1);
    }
  }
  for (std::size_t square = 0; square < squares; ++square) {
    if (level.cell_at[square] < 0) continue;
    map.cells.push_back(
        {static_cast<float>(level.west_m + (static_cast<double>(square % level.columns) + 0.5) * map.cell_m),
         static_cast<float>(level.south_m + (static_cast<double>(square / level.columns) + 0.5) * map.cell_m),
         static_cast<float>(kPathUnit_m * reader.integer<std::uint8_t>())});
  }
  map.levels.push_back(std::move(level));
}

void write_transmitter(Writer& writer, const RadioMap& map, const Transmitter& transmitter) {
  writer.text(transmitter.id);
  writer.integer(static_cast<std::uint8_t>(transmitter.radio));
  writer.compact(static_cast<std::uint32_t>(transmitter.spans.size()));
  for (const auto& span : transmitter.spans) {
    writer.compact(span.level_index);
    writer.compact(span.end - span.begin);
    std::uint32_t next = 0;
    for (std::uint32_t i = span.begin; i < span.end; ++i) {
      const Expectation& e = map.expectations[i];
      writer.compact(e.cell - next);
      next = e.cell + 1u;
      writer.integer(e.rssi_q);
      writer.integer(e.heard_q);
    }
  }
}

void read_transmitter(Reader& reader, RadioMap& map) {
  Transmitter transmitter;
  transmitter.id = reader.text();
  const auto radio = reader.integer<std::uint8_t>();
  reader.require(radio <= static_cast<std::uint8_t>(Radio::Bluetooth), "an unknown kind of radio");
  transmitter.radio = static_cast<Radio>(radio);
  const std::uint32_t spans = reader.compact();
  reader.require(spans <= map.levels.size(), "a transmitter on more levels than there are");
  for (std::uint32_t s = 0; s < spans; ++s) {
    const std::uint32_t level_index = reader.compact();
    reader.require(level_index < map.levels.size(), "a transmitter on a level that does not exist");
    const std::uint32_t count = reader.compact();
    const auto begin = static_cast<std::uint32_t>(map.expectations.size());
    std::uint64_t next = 0;
    for (std::uint32_t i = 0; i < count; ++i) {
      next += reader.compact();
      reader.require(next < map.levels[level_index].cell_count && next <= 0xFFFF, "a cell that does not exist");
      const auto rssi_q = reader.integer<std::uint8_t>();
      map.expectations.push_back({static_cast<std::uint16_t>(next++), rssi_q, reader.integer<std::uint8_t>()});
    }
    transmitter.spans.push_back({level_index, begin, begin + count});
  }
  map.transmitters.push_back(std::move(transmitter));
}

RadioMap read_payload(Reader& reader) {
  RadioMap map;
  map.name = reader.text();
  if (reader.integer<std::uint8_t>() != 0) {
    const double latitude_deg = reader.real();
    map.reference = Reference{latitude_deg, reader.real()};
    reader.require(std::abs(latitude_deg) <= 90.0 && std::abs(map.reference->longitude_deg) <= 180.0,
                   "a reference that is no place on Earth");
  }
  map.cell_m = reader.real();
  reader.require(map.cell_m > 0.01 && map.cell_m < 1000.0, "cells of impossible size");
  map.accuracy.covariance_factor = reader.real();
  map.accuracy.covariance_floor_m = reader.real();
  reader.require(map.accuracy.covariance_factor > 0.0 && map.accuracy.covariance_factor < 1e4 &&
                     map.accuracy.covariance_floor_m >= 0.0 && map.accuracy.covariance_floor_m < 1e4,
                 "an impossible accuracy");
  const std::uint32_t levels = reader.count(28);
  reader.require(levels > 0, "no level");
  std::int64_t squares_left = kMostSquares;
  for (std::uint32_t i = 0; i < levels; ++i) {
    read_level(reader, map, squares_left);
    squares_left -= static_cast<std::int64_t>(map.levels.back().cell_at.size());
  }
  reader.require(!map.cells.empty(), "no cell");
  const std::uint32_t transmitters = reader.count(4);
  for (std::uint32_t i = 0; i < transmitters; ++i) read_transmitter(reader, map);
  reader.require(reader.at_end(), "bytes after its end");
  return map;
}

std::string read_file(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::error_code error;
  const auto size = fs::is_regular_file(file, error) ? fs::file_size(file, error) : std::uintmax_t{0};
  if (!stream || error || !fs::is_regular_file(file)) {
    throw Error(ErrorCode::NotFound, {.what = "there is no radio map of that name",
                                      .where = file.string(),
                                      .expected = "a file written by fiona-radiomap",
                                      .found = error ? error.message() : "no readable file",
                                      .next = "learn one: fiona-radiomap learn DIR -o FILE"});
  }
  std::string bytes(std::min(size, kMostBytes + 1), '\0');
  stream.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<std::size_t>(stream.gcount()));
  return bytes;
}

[[noreturn]] void cannot_write(const fs::path& file, const std::error_code& error) {
  throw Error(ErrorCode::Failed, {.what = "the file cannot be written: " + error.message(),
                                  .where = file.string(),
                                  .expected = "a folder that exists, may be written, and has room",
                                  .next = "choose another file with -o"});
}

}  // namespace

void save(const RadioMap& map, const fs::path& file) {
  Writer payload;
  payload.text(map.name);
  payload.integer(static_cast<std::uint8_t>(map.reference ? 1 : 0));
  if (map.reference) payload.real(map.reference->latitude_deg), payload.real(map.reference->longitude_deg);
  payload.real(map.cell_m);
  payload.real(map.accuracy.covariance_factor);
  payload.real(map.accuracy.covariance_floor_m);
  payload.integer(static_cast<std::uint32_t>(map.levels.size()));
  for (const Level& level : map.levels) write_level(payload, map, level);
  payload.integer(static_cast<std::uint32_t>(map.transmitters.size()));
  for (const Transmitter& transmitter : map.transmitters) write_transmitter(payload, map, transmitter);

  Writer header;
  header.bytes = kMagic;
  header.integer(kRadioMapVersion);
  header.integer(static_cast<std::uint64_t>(payload.bytes.size()));
  header.integer(checksum(payload.bytes));
  const fs::path draft = file.string() + ".draft";
  std::error_code error;
  {
    errno = 0;
    std::ofstream stream(draft, std::ios::binary | std::ios::trunc);
    stream << header.bytes << payload.bytes;
    stream.close();
    if (!stream) error.assign(errno != 0 ? errno : EIO, std::generic_category());
  }
  if (!error) fs::rename(draft, file, error);
  if (!error) return;
  std::error_code ignored;
  fs::remove(draft, ignored);
  cannot_write(file, error);
}

void check_writable(const fs::path& file) {
  std::error_code error;
  const bool is_new = !fs::exists(file, error);
  const int opened = ::open(file.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0666);
  if (opened < 0) cannot_write(file, {errno, std::generic_category()});
  ::close(opened);
  if (is_new) fs::remove(file, error);
}

RadioMap load(const fs::path& file) { return parse(read_file(file), file); }

RadioMap parse(std::string_view bytes, const fs::path& file) {
  Reader header(bytes, file);
  if (bytes.size() < kHeaderBytes || header.take(kMagic.size()) != kMagic) header.fail("another kind of file");
  const auto version = header.integer<std::uint32_t>();
  if (version != kRadioMapVersion) {
    throw Error(ErrorCode::Failed,
                {.what = "the radio map is of another format version",
                 .where = file.string(),
                 .expected = "version " + std::to_string(kRadioMapVersion),
                 .found = "version " + std::to_string(version),
                 .next = "learn it again with this fiona-radiomap: fiona-radiomap learn DIR -o FILE"});
  }
  const auto length = header.integer<std::uint64_t>();
  const auto expected = header.integer<std::uint64_t>();
  const std::string_view payload = bytes.substr(kHeaderBytes);
  if (payload.size() != length) {
    header.fail(std::to_string(payload.size()) + " bytes of " + std::to_string(length));
  }
  if (checksum(payload) != expected) header.fail("a checksum that does not fit");
  Reader reader(payload, file);
  RadioMap map = read_payload(reader);
  map.index();
  return map;
}

}  // namespace fiona::radio
