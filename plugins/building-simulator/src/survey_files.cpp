#include <algorithm>
#include <array>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <fstream>
#include <memory>
#include <system_error>

#include <archive.h>
#include <archive_entry.h>

#include <fiona/error.hpp>
#include <fiona/units.hpp>

#include "fiona/simulator/survey.hpp"

namespace fiona::simulator {
namespace {

using building::Building;

/// Walks happen ten minutes apart, from 1 January 2026 on: dates are part of the format, and of the bytes.
constexpr std::int64_t kFirstStart_ms = 1'767'225'600'000;
constexpr std::int64_t kBetweenStarts_ms = 600'000;
constexpr double kDegree_rad = 3.14159265358979323846 / 180.0;
constexpr double kMicroteslaPerGauss = 100.0;

[[noreturn]] void cannot_write(const std::filesystem::path& path, const std::string& cause) {
  throw Error(ErrorCode::Failed, {.what = "cannot write " + path.string() + ": " + cause,
                                  .where = path.string(),
                                  .next = "check that the directory may be written and has space, then start again "
                                          "with a new directory"});
}

/// An archive of text files: tar, compressed with xz; the same content gives the same bytes.
class TarXz {
 public:
  explicit TarXz(std::filesystem::path path) : path_(std::move(path)) {
    archive_.reset(archive_write_new());
    check(archive_write_set_format_ustar(archive_.get()));
    check(archive_write_add_filter_xz(archive_.get()));
    check(archive_write_open_filename(archive_.get(), path_.c_str()));
  }

  void add(const std::string& name, const std::string& text, std::int64_t time_s) {
    const std::unique_ptr<archive_entry, decltype(&archive_entry_free)> entry{archive_entry_new(), archive_entry_free};
    archive_entry_set_pathname(entry.get(), name.c_str());
    archive_entry_set_filetype(entry.get(), AE_IFREG);
    archive_entry_set_perm(entry.get(), 0644);
    archive_entry_set_size(entry.get(), static_cast<std::int64_t>(text.size()));
    archive_entry_set_mtime(entry.get(), time_s, 0);
    check(archive_write_header(archive_.get(), entry.get()));
    if (archive_write_data(archive_.get(), text.data(), text.size()) != static_cast<la_ssize_t>(text.size())) fail();
  }

  void close() { check(archive_write_close(archive_.get())); }

 private:
  void check(int result) {
    if (result != ARCHIVE_OK) fail();
  }
  [[noreturn]] void fail() {
    const char* cause = archive_error_string(archive_.get());
    cannot_write(path_, cause == nullptr ? "the archive could not be made" : cause);
  }

  std::filesystem::path path_;
  std::unique_ptr<archive, decltype(&archive_write_free)> archive_{nullptr, archive_write_free};
};

[[gnu::format(printf, 1, 2)]] std::string format(const char* pattern, ...) {
  std::array<char, 512> text{};
  std::va_list values;
  va_start(values, pattern);
  std::vsnprintf(text.data(), text.size(), pattern, values);
  va_end(values);
  return text.data();
}

struct Row {
  std::int64_t t_ms;
  std::string text;
};

void add_vector(std::vector<Row>& rows, char tag, std::int64_t t_ms, const std::array<double, 3>& v, double scale) {
  rows.push_back({t_ms, format("%c\t%lld\t%.4g\t%.4g\t%.4g\n", tag, static_cast<long long>(t_ms), v[0] * scale,
                               v[1] * scale, v[2] * scale)});
}

void add_inertial(std::vector<Row>& rows, const Trace& trace) {
  for (const ImuSample& sample : trace.imu) {
    const std::int64_t t = sample.t.count();
    add_vector(rows, 'A', t, sample.acceleration_g, kStandardGravity_mps2);
    add_vector(rows, 'M', t, sample.magnetic_gauss, kMicroteslaPerGauss);
    add_vector(rows, 'G', t, sample.rotation_deg_s, kDegree_rad);
    add_vector(rows, 'R', t, sample.rotation_vector, 1.0);
  }
}

void add_radio(std::vector<Row>& rows, const Trace& trace) {
  for (const WifiScan& scan : trace.scans) {
    for (const WifiReading& reading : scan.readings) {
      std::string bssid = reading.bssid;
      std::erase(bssid, ':');
      rows.push_back({scan.t.count(),
                      format("W\t%lld\t%s\t%d\t%d\t%lld\n", static_cast<long long>(scan.t.count()), bssid.c_str(),
                             reading.rssi_dbm, reading.frequency_mhz, static_cast<long long>(reading.heard.count()))});
    }
  }
  for (const BeaconReading& beacon : trace.beacons) {
    rows.push_back(
        {beacon.heard.count(), format("B\t%lld\t%s\t%d\t%d\t%d\t%d\t%s\n", static_cast<long long>(beacon.heard.count()),
                                      beacon.uuid.c_str(), beacon.major, beacon.minor, beacon.measured_power_dbm,
                                      beacon.rssi_dbm, beacon_address(beacon).c_str())});
  }
}

std::string floor_name(double level) {
  const int floor = static_cast<int>(level);
  return floor < 0 ? format("B%d", -floor) : format("F%d", floor + 1);
}

std::string trace_text(const Trace& trace, std::int64_t start_ms, bool with_truth) {
  std::vector<Row> rows;
  if (with_truth) {
    for (const Truth& p : trace.waypoints) {
      rows.push_back({p.t.count(), format("P\t%lld\t%.3f\t%.3f\n", static_cast<long long>(p.t.count()), p.x_m, p.y_m)});
    }
  }
  add_inertial(rows, trace);
  add_radio(rows, trace);
  std::stable_sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) { return a.t_ms < b.t_ms; });
  std::string text = format("# trace=%s start_ms=%lld", trace.id.c_str(), static_cast<long long>(start_ms));
  if (with_truth)
    text += format(" floor=%d floor_name=%s", static_cast<int>(trace.level), floor_name(trace.level).c_str());
  text += "\n";
  for (const Row& row : rows) text += row.text;
  return text;
}

std::string index_line(const Trace& trace, std::int64_t start_ms, bool test) {
  std::size_t wifi_rows = 0;
  for (const WifiScan& scan : trace.scans) wifi_rows += scan.readings.size();
  const std::string floor = test ? "," : floor_name(trace.level) + format(",%d", static_cast<int>(trace.level));
  return format("%s,%s,%s,%lld,%.1f,%zu,%zu,%zu,%.1f\n", trace.id.c_str(), test ? "test" : "train", floor.c_str(),
                static_cast<long long>(start_ms), static_cast<double>(trace.duration.count()) / 1000.0,
                trace.waypoints.size(), wifi_rows, trace.beacons.size(), trace.imu.empty() ? 0.0 : 50.0);
}

void write_text(const std::filesystem::path& path, const std::string& text) {
  std::ofstream stream(path, std::ios::binary);
  stream << text;
  stream.close();
  if (!stream) cannot_write(path, "the file could not be written");
}

void make_directory(const std::filesystem::path& path) {
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (error) cannot_write(path, error.message());
}

void refuse_filled(const std::filesystem::path& directory) {
  std::error_code error;
  if (!std::filesystem::exists(directory, error)) return;
  if (std::filesystem::is_directory(directory, error) && std::filesystem::is_empty(directory, error)) return;
  throw Error(ErrorCode::Failed, {.what = "cannot write the survey to " + directory.string() + ": it is not empty",
                                  .where = directory.string(),
                                  .expected = "a directory that does not exist or is empty",
                                  .next = "name another directory"});
}

std::string floor_info(const Building& building, double level) {
  double width = 0.0, height = 0.0;
  const auto take = [&](const building::Ring& ring) {
    if (ring.empty()) return;
    const building::Box box = bounds(ring);
    width = std::max(width, box.high.x_m), height = std::max(height, box.high.y_m);
  };
  take(building.plan().outline.outer);
  for (const building::Room& room : building.rooms()) {
    if (room.level == level) take(room.polygon.outer);
  }
  return format("{\n  \"map_info\": {\n    \"height\": %.3f,\n    \"width\": %.3f\n  }\n}\n", height, width);
}

/// Keeps what belongs to all levels: the index, the tests and their truth.
class SurveyWriter {
 public:
  explicit SurveyWriter(const std::filesystem::path& directory)
      : directory_(directory), tests_(directory / "test.tar.xz") {}

  void add_level(const Building& building, double level, const std::vector<Trace>& survey) {
    const std::filesystem::path folder = directory_ / floor_name(level);
    make_directory(folder);
    write_text(folder / "floor_info.json", floor_info(building, level));
    TarXz archive{folder / "train.tar.xz"};
    for (const Trace& trace : survey) {
      const std::int64_t start_ms = next_start();
      archive.add("train/" + trace.id + ".tsv", trace_text(trace, start_ms, true), start_ms / 1000);
      train_index_ += index_line(trace, start_ms, false);
    }
    archive.close();
  }

  void add_tests(const std::vector<Trace>& tests) {
    for (const Trace& trace : tests) {
      const std::int64_t start_ms = next_start();
      tests_.add("test/" + trace.id + ".tsv", trace_text(trace, start_ms, false), start_ms / 1000);
      test_index_ += index_line(trace, start_ms, true);
      for (const Truth& p : trace.waypoints) {
        truth_ += format("%s,%lld,%.3f,%.3f,%d\n", trace.id.c_str(), static_cast<long long>(p.t.count()), p.x_m, p.y_m,
                         static_cast<int>(trace.level));
      }
    }
  }

  void close(const Building& building, std::uint64_t seed) {
    tests_.close();
    write_text(directory_ / "test_truth.csv", "trace,t_ms,x,y,floor\n" + truth_);
    write_text(directory_ / "traces.csv",
               "trace,split,floor_name,floor,start_ms,duration_s,waypoints,wifi_rows,beacon_rows,imu_hz\n" +
                   test_index_ + train_index_);
    write_text(directory_ / "README.md", "# Simulated survey of " + building.name() + ", seed " + std::to_string(seed) +
                                             "\n\nWritten by fiona-survey in the layout of indoor20_site1. "
                                             "Places are metres in the local frame "
                                             "of the building file.\n");
  }

 private:
  std::int64_t next_start() { return kFirstStart_ms + kBetweenStarts_ms * count_++; }

  std::filesystem::path directory_;
  TarXz tests_;
  std::string train_index_{};
  std::string test_index_{};
  std::string truth_{};
  std::int64_t count_ = 0;
};

}  // namespace

SurveyReport write_survey(const Building& building, std::uint64_t seed, const std::filesystem::path& directory,
                          const SurveyOptions& options) {
  refuse_filled(directory);
  make_directory(directory);
  SurveyReport report;
  SurveyWriter writer{directory};
  for (const building::Level& level : building.levels()) {
    const bool has_rooms = std::any_of(building.rooms().begin(), building.rooms().end(),
                                       [&](const building::Room& room) { return room.level == level.level; });
    if (!has_rooms || level.level != std::floor(level.level)) {
      report.notes.push_back("level " + building::level_text(level.level) + " was left out: " +
                             (has_rooms ? "the layout knows whole floors only" : "it has no rooms"));
      continue;
    }
    const std::vector<Trace> survey = survey_walk(building, level.level, seed, options);
    const std::vector<Trace> tests = test_walks(building, level.level, seed, options);
    writer.add_level(building, level.level, survey);
    writer.add_tests(tests);
    ++report.levels;
    report.survey_walks += survey.size();
    report.test_walks += tests.size();
  }
  writer.close(building, seed);
  return report;
}

}  // namespace fiona::simulator
