#include "trace_parser.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include <fiona/error.hpp>

namespace fiona::walk {

/// The tab-separated fields of one line, without copies. Ten is one more than any row has.
struct FieldList {
  std::array<std::string_view, 10> text;
  std::size_t count = 0;
};

namespace {

constexpr std::size_t kMostShown = 60;
constexpr std::int64_t kLongestWalk_ms = 86'400'000;  // a day: what reads a walk in steps of time must come to an end
constexpr std::int64_t kHighestFloor = 1000;
constexpr double kLargestNumber = 1e8;  // fits in a float and in any sum of squares

FieldList split(std::string_view line) {
  FieldList fields;
  while (fields.count < fields.text.size()) {
    const auto tab = line.find('\t');
    fields.text[fields.count++] = line.substr(0, tab);
    if (tab == std::string_view::npos) break;
    line.remove_prefix(tab + 1);
  }
  return fields;
}

/// Without the locale of std::tolower.
char lower_case(char letter) { return letter >= 'A' && letter <= 'Z' ? static_cast<char>(letter - 'A' + 'a') : letter; }

}  // namespace

TraceParser::TraceParser(std::string where, std::optional<int> level, std::size_t most_events)
    : where_(std::move(where)), level_(level), most_events_(most_events) {
  walk_.level = level;
}

void TraceParser::fail(const std::string& what, const std::string& expected, std::string_view found) const {
  throw Error(ErrorCode::Failed, {.what = what,
                                  .where = where_ + ":" + std::to_string(line_number_),
                                  .expected = expected,
                                  .found = std::string(found.substr(0, kMostShown)),
                                  .next = "get the archive again from its source, or leave this walk out of it"});
}

void TraceParser::line(std::string_view text) {
  ++line_number_;
  if (!text.empty() && text.back() == '\r') text.remove_suffix(1);
  if (line_number_ == 1) return header(text);
  if (text.empty()) return;
  row(split(text));
}

void TraceParser::header(std::string_view text) {
  if (!text.starts_with("# trace=")) fail("this is not a recorded walk", "a first line `# trace=NAME …`", text);
  text.remove_prefix(2);
  while (!text.empty()) {
    const auto blank = text.find(' ');
    const std::string_view word = text.substr(0, blank);
    const auto equals = word.find('=');
    const std::string_view key = word.substr(0, equals);
    const std::string_view value = equals == std::string_view::npos ? "" : word.substr(equals + 1);
    const auto as_integer = [&]() {
      std::int64_t result = 0;
      const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), result);
      if (error != std::errc() || end != value.data() + value.size()) {
        fail("the walk's header is garbled", "a whole number after " + std::string(key) + "=", value);
      }
      return result;
    };
    if (key == "trace") walk_.name = value;
    if (key == "start_ms") walk_.start_ms = as_integer();
    if (key == "floor" && as_integer() != level_.value_or(static_cast<int>(as_integer()))) {
      fail("the walk's header names another floor than its folder", "floor=" + std::to_string(*level_), value);
    }
    text.remove_prefix(blank == std::string_view::npos ? text.size() : blank + 1);
  }
}

void TraceParser::row(const FieldList& fields) {
  if (fields.text[0] == "N") return;  // the phone's own satellite or network fix: no part of indoor localisation
  if (walk_.events.size() == most_events_) {
    fail("the walk is longer than the reader accepts", "at most " + std::to_string(most_events_) + " rows", "more");
  }
  if (fields.count < 2) fail("a row is garbled", "a tag and a time, separated by a tab", fields.text[0]);
  const std::int64_t t_ms = integer_within(fields, 1, "a time in ms", -kLongestWalk_ms, kLongestWalk_ms);
  if (!walk_.events.empty() && t_ms < walk_.events.back().t_ms) {
    fail("time goes back within the walk",
         std::to_string(walk_.events.back().t_ms) + " ms, as the row before, or later", fields.text[1]);
  }
  walk_.events.push_back({t_ms, parse(fields, t_ms)});
}

EventData TraceParser::parse(const FieldList& fields, std::int64_t t_ms) {
  const std::string_view tag = fields.text[0];
  const auto axes = [&](auto result) {
    need(fields, 5, 5, "tag, time, x, y, z");
    result.x = static_cast<float>(number(fields, 2, "x"));
    result.y = static_cast<float>(number(fields, 3, "y"));
    result.z = static_cast<float>(number(fields, 4, "z"));
    return result;
  };
  if (tag == "A") return axes(Accelerometer{});
  if (tag == "G") return axes(Gyroscope{});
  if (tag == "M") return axes(Magnetometer{});
  if (tag == "R") return axes(RotationVector{});
  if (tag == "W") return wifi(fields, t_ms);
  if (tag == "B") return beacon(fields);
  if (tag == "P") return way_point(fields);
  if (tag == "H") {
    need(fields, 3, 3, "H, time, hPa");
    return Pressure{static_cast<float>(number(fields, 2, "a pressure in hPa"))};
  }
  fail("a row has an unknown tag", "one of A G M R W B H N P", tag);
}

EventData TraceParser::wifi(const FieldList& fields, std::int64_t t_ms) {
  need(fields, 5, 6, "W, time, bssid, rssi, frequency and, if known, the time heard");
  const std::int64_t told_ms = fields.count == 6 ? integer(fields, 5, "the time heard in ms") : t_ms;
  const std::int64_t heard_ms = std::clamp(told_ms, -kLongestWalk_ms, t_ms);
  return WifiRow{transmitter(fields.text[2]), static_cast<float>(number(fields, 3, "an RSSI in dBm")),
                 static_cast<std::int32_t>(integer_within(fields, 4, "a frequency in MHz", 0, 1'000'000)), heard_ms};
}

EventData TraceParser::beacon(const FieldList& fields) {
  need(fields, 7, 8, "B, time, uuid, major, minor, transmit power if known, rssi, mac");
  const std::size_t rssi = fields.count - 2;
  BeaconIdentity beacon{.uuid = std::string(fields.text[2]),
                        .major = static_cast<std::uint32_t>(integer_within(fields, 3, "a major", 0, 65535)),
                        .minor = static_cast<std::uint32_t>(integer_within(fields, 4, "a minor", 0, 65535))};
  if (beacon.uuid.empty()) fail("a row is garbled", "a beacon's UUID", "nothing");
  std::transform(beacon.uuid.begin(), beacon.uuid.end(), beacon.uuid.begin(), lower_case);
  if (fields.count == 8) {
    beacon.measured_power_dbm = static_cast<int>(integer_within(fields, 5, "a power at 1 m in dBm", -128, 127));
  }
  return BeaconRow{transmitter(fields.text[rssi + 1]), identity(std::move(beacon)),
                   static_cast<float>(number(fields, rssi, "an RSSI in dBm"))};
}

EventData TraceParser::way_point(const FieldList& fields) {
  need(fields, 4, 5, "P, time, x, y and, where the walk changes floors, the floor");
  if (fields.count == 4 && !level_) fail("a way-point does not say its floor", "P, time, x, y, floor", "no floor");
  const std::int64_t level =
      fields.count == 5 ? integer_within(fields, 4, "a floor", -kHighestFloor, kHighestFloor) : *level_;
  return WayPoint{number(fields, 2, "x in metres"), number(fields, 3, "y in metres"), static_cast<int>(level)};
}

double TraceParser::number(const FieldList& fields, std::size_t index, const char* meaning) const {
  const std::string_view text = fields.text[index];
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !(std::abs(value) <= kLargestNumber)) {
    fail("a row is garbled", std::string("a number: ") + meaning, text);
  }
  return value;
}

std::int64_t TraceParser::integer(const FieldList& fields, std::size_t index, const char* meaning) const {
  const std::string_view text = fields.text[index];
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) {
    fail("a row is garbled", std::string("a whole number: ") + meaning, text);
  }
  return value;
}

std::int64_t TraceParser::integer_within(const FieldList& fields, std::size_t index, const char* meaning,
                                         std::int64_t least, std::int64_t most) const {
  const std::int64_t value = integer(fields, index, meaning);
  if (value >= least && value <= most) return value;
  fail("a row is garbled", std::string(meaning) + " from " + std::to_string(least) + " to " + std::to_string(most),
       fields.text[index]);
}

void TraceParser::need(const FieldList& fields, std::size_t least, std::size_t most, const char* expected) const {
  if (fields.count >= least && fields.count <= most) return;
  fail("a row is garbled", expected, std::to_string(fields.count) + " fields");
}

std::uint32_t TraceParser::transmitter(std::string_view name) {
  if (name.empty()) fail("a row is garbled", "a transmitter's address", "nothing");
  const auto [entry, added] =
      transmitter_index_.try_emplace(std::string(name), static_cast<std::uint32_t>(walk_.transmitters.size()));
  if (added) walk_.transmitters.emplace_back(name);
  return entry->second;
}

std::uint32_t TraceParser::identity(BeaconIdentity beacon) {
  const auto [entry, added] = beacon_index_.try_emplace(beacon, static_cast<std::uint32_t>(walk_.beacons.size()));
  if (added) walk_.beacons.push_back(std::move(beacon));
  return entry->second;
}

Walk TraceParser::finish() {
  if (line_number_ == 0) {
    ++line_number_;
    fail("this is not a recorded walk", "a first line `# trace=NAME …`", "an empty file");
  }
  return std::move(walk_);
}

}  // namespace fiona::walk
