#include "beacon_map.hpp"

#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <fstream>
#include <numbers>
#include <set>
#include <system_error>

#include "fiona/error.hpp"

namespace fiona::beacons {
namespace {

constexpr std::uintmax_t kMostBytes = 64u << 20;
constexpr int kMostBeacons = 65536;
constexpr int kMostPlaces = 100'000;
constexpr double kFarthest_m = 10'000.0;
constexpr int kHighestLevel = 1000;

/// Keeps the first fault.
struct FirstFault final : google::protobuf::io::ErrorCollector {
  void AddError(int at_line, google::protobuf::io::ColumnNumber at_column, const std::string& message) override {
    if (!text.empty()) return;
    line = at_line + 1;
    column = at_column + 1;
    text = message;
  }
  int line = 0, column = 0;
  std::string text;
};

class Check {
 public:
  explicit Check(const std::string& name) : name_(name) {}

  void number(const std::string& what, double value, double least, double most) const {
    if (std::isfinite(value) && value >= least && value <= most) return;
    refuse(what + " cannot be " + std::to_string(value), std::to_string(least) + " to " + std::to_string(most));
  }
  [[noreturn]] void refuse(std::string what, std::string expected) const {
    throw Error(ErrorCode::Usage, {.what = std::move(what), .where = name_, .expected = std::move(expected)});
  }
  void place(const std::string& what, double x, double y, int level) const {
    number(what + ": x", x, -kFarthest_m, kFarthest_m);
    number(what + ": y", y, -kFarthest_m, kFarthest_m);
    number(what + ": level", level, -kHighestLevel, kHighestLevel);
  }

 private:
  const std::string& name_;
};

void check_beacons(const BeaconMap& map, const Check& check) {
  if (map.beacons().empty()) check.refuse("the map has no beacon", "beacons { id: … x: … y: … heard { … } }");
  if (map.beacons_size() > kMostBeacons) check.refuse("too many beacons", "at most " + std::to_string(kMostBeacons));
  std::set<std::string> ids;
  for (const auto& beacon : map.beacons()) {
    const std::string what = "beacon '" + beacon.id() + "'";
    if (normalised_id(beacon.id()).empty()) check.refuse("a beacon has no id", "its address, or UUID/MAJOR/MINOR");
    if (!ids.insert(normalised_id(beacon.id())).second) check.refuse(what + " is there twice", "each beacon once");
    if (beacon.heard().empty()) check.refuse(what + " is on no level", "heard { level: … power: … }");
    if (beacon.has_exponent()) check.number(what + ": exponent", beacon.exponent(), 0.0, 10.0);
    for (const auto& on : beacon.heard()) {
      check.place(what, beacon.x(), beacon.y(), on.level());
      check.number(what + ": power", on.power(), -150.0, 50.0);
    }
  }
}

void check_survey(const BeaconMap& map, const Check& check) {
  if (map.survey_size() > kMostPlaces) check.refuse("too many places", "at most " + std::to_string(kMostPlaces));
  for (int i = 0; i < map.survey_size(); ++i) {
    const auto& place = map.survey(i);
    const std::string what = "place " + std::to_string(i + 1);
    check.place(what, place.x(), place.y(), place.level());
    for (const auto& reading : place.readings()) {
      if (reading.beacon() >= static_cast<std::uint32_t>(map.beacons_size())) {
        check.refuse(what + " heard beacon " + std::to_string(reading.beacon()),
                     "0 to " + std::to_string(map.beacons_size() - 1));
      }
      check.number(what + ": rssi", reading.rssi(), -200.0, 50.0);
    }
  }
}

void check_compass(const BeaconMap& map, const Check& check) {
  if (map.compass_size() > kMostPlaces) check.refuse("too many deviations", "at most " + std::to_string(kMostPlaces));
  for (int i = 0; i < map.compass_size(); ++i) {
    const auto& deviation = map.compass(i);
    const std::string what = "compass " + std::to_string(i + 1);
    check.place(what, deviation.x(), deviation.y(), deviation.level());
    check.number(what + ": angle", deviation.angle(), -std::numbers::pi, std::numbers::pi);
  }
}

void check_reference(const BeaconMap& map, const Check& check) {
  check.number("reference: latitude", map.reference().latitude(), -90.0, 90.0);
  check.number("reference: longitude", map.reference().longitude(), -180.0, 180.0);
  check.number("reference: heading", map.reference().heading(), -360.0, 360.0);
}

void fill(google::protobuf::Message& message, const google::protobuf::Message& usual, const Check& check) {
  const auto& reflection = *message.GetReflection();
  const auto& type = *message.GetDescriptor();
  for (int i = 0; i < type.field_count(); ++i) {
    const auto* field = type.field(i);
    if (!reflection.HasField(message, field)) {
      reflection.SetDouble(&message, field, reflection.GetDouble(usual, field));
    }
    const bool negative = field->name() == "threshold";
    check.number(type.name() + "." + field->name(), reflection.GetDouble(message, field), negative ? -200.0 : 1e-3,
                 1e4);
  }
}

}  // namespace

BeaconMap::Radio usual_radio() {
  BeaconMap::Radio radio;
  radio.set_level_loss(18.0);
  radio.set_shadowing(5.0);
  radio.set_shadowing_reach(2.5);
  radio.set_reading(4.0);
  radio.set_threshold(-95.0);
  radio.set_slope(4.0);
  radio.set_heard_most(0.95);
  radio.set_offset(6.0);
  return radio;
}

BeaconMap::Accuracy careful_accuracy() {
  BeaconMap::Accuracy accuracy;
  accuracy.set_factor(3.0);
  accuracy.set_floor(1.0);
  return accuracy;
}

BeaconMap parse(std::string_view text, const std::string& name) {
  BeaconMap map;
  FirstFault fault;
  google::protobuf::TextFormat::Parser parser;
  parser.RecordErrorsTo(&fault);
  parser.SetRecursionLimit(10);
  google::protobuf::io::ArrayInputStream bytes(text.data(),
                                               static_cast<int>(std::min<std::size_t>(text.size(), kMostBytes)));
  if (!parser.Parse(&bytes, &map)) {
    throw Error(ErrorCode::Usage,
                {.what = "this is no beacon map: " + fault.text,
                 .where = name + ":" + std::to_string(fault.line) + ":" + std::to_string(fault.column),
                 .next = "fiona-beaconmap learn FOLDER -o FILE makes one; README.md of the package shows one by hand"});
  }
  const Check check(name);
  check_beacons(map, check);
  check_survey(map, check);
  check_compass(map, check);
  check_reference(map, check);
  fill(*map.mutable_radio(), usual_radio(), check);
  fill(*map.mutable_accuracy(), careful_accuracy(), check);
  if (map.radio().heard_most() >= 1.0) check.refuse("Radio.heard_most is 1 or more", "a share below 1");
  return map;
}

BeaconMap load(const std::filesystem::path& file) {
  std::error_code none;
  const std::uintmax_t size = std::filesystem::file_size(file, none);
  std::ifstream stream(file, std::ios::binary);
  if (none || !stream) {
    throw Error(ErrorCode::NotFound, {.what = "the beacon map cannot be read",
                                      .where = file.string(),
                                      .next = "fiona-beaconmap learn SURVEY -o FILE makes one"});
  }
  if (size > kMostBytes)
    throw Error(ErrorCode::Usage, {.what = "the beacon map is too large",
                                   .where = file.string(),
                                   .expected = std::to_string(kMostBytes >> 20) + " MiB at most",
                                   .found = std::to_string(size >> 20) + " MiB"});
  return parse(std::string(std::istreambuf_iterator<char>(stream), {}), file.string());
}

void save(const BeaconMap& map, const std::filesystem::path& file) {
  std::string text;
  google::protobuf::TextFormat::PrintToString(map, &text);
  errno = 0;
  std::ofstream stream(file, std::ios::binary | std::ios::trunc);
  stream << text;
  stream.close();
  if (!stream)
    throw Error(ErrorCode::Failed,
                {.what = "the beacon map cannot be written: " + std::generic_category().message(errno ? errno : EIO),
                 .where = file.string(),
                 .next = "-o FILE names one that can"});
}

std::optional<building::Reference> reference_of(const BeaconMap& map) {
  if (!map.has_reference()) return std::nullopt;
  const auto& told = map.reference();
  return building::Reference{told.latitude(), told.longitude(), told.heading() * std::numbers::pi / 180.0, true};
}

void set_reference(BeaconMap& map, const building::Reference& reference) {
  auto& told = *map.mutable_reference();
  told.set_latitude(reference.latitude_deg);
  told.set_longitude(reference.longitude_deg);
  told.set_heading(reference.heading_rad * 180.0 / std::numbers::pi);
}

BeaconMap moved(BeaconMap map, const building::Placement& how) {
  const auto move = [&](auto& at) {
    const building::Point to = how.place(building::Point{at.x(), at.y()});
    at.set_x(to.x_m);
    at.set_y(to.y_m);
  };
  for (auto& beacon : *map.mutable_beacons()) move(beacon);
  for (auto& place : *map.mutable_survey()) move(place);
  for (auto& deviation : *map.mutable_compass()) move(deviation);
  return map;
}

std::string normalised_id(std::string_view id) {
  const bool triplet = id.find('/') != std::string_view::npos;
  std::string result;
  for (const char c : id) {
    if (!triplet && (c == ':' || c == '-')) continue;
    result += c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  }
  return result;
}

}  // namespace fiona::beacons
