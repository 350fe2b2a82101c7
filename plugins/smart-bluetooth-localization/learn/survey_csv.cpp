#include "survey_csv.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <map>

#include "fiona/error.hpp"

namespace fiona::beacons {
namespace {

constexpr std::size_t kMostRows = 20'000'000;
constexpr double kMostTime = 1e15, kFarthest_m = 10'000.0, kHighestLevel = 1000.0, kMostRssi_dbm = 200.0;

std::ifstream open(const std::filesystem::path& file) {
  std::ifstream stream(file);
  if (!stream)
    throw Error(ErrorCode::NotFound,
                {.what = "the file cannot be read", .where = file.string(), .next = "check its path"});
  return stream;
}

class Rows {
 public:
  Rows(std::istream& stream, const std::string& name, const std::string& header) : file_(name), stream_(stream) {
    columns_ = static_cast<std::size_t>(std::count(header.begin(), header.end(), ',')) + 1;
    std::string found;
    std::getline(stream_, found);
    if (!found.empty() && found.back() == '\r') found.pop_back();
    if (found != header) {
      throw Error(ErrorCode::Usage, {.what = "the first line does not name the columns",
                                     .where = file_ + ":1",
                                     .expected = header,
                                     .found = found});
    }
  }

  bool next() {
    std::string text;
    if (!std::getline(stream_, text)) return false;
    if (!text.empty() && text.back() == '\r') text.pop_back();
    if (++line_ > kMostRows) refuse("there are too many rows", "at most " + std::to_string(kMostRows), "");
    cells_.clear();
    std::size_t from = 0;
    for (std::size_t comma; (comma = text.find(',', from)) != std::string::npos; from = comma + 1) {
      cells_.push_back(text.substr(from, comma - from));
    }
    cells_.push_back(text.substr(from));
    if (cells_.size() != columns_) refuse("a row has too few or too many cells", std::to_string(columns_), text);
    return true;
  }
  const std::string& text(std::size_t column) const { return cells_[column]; }
  /// From -`most` to `most`.
  double number(std::size_t column, double most) const {
    double value = 0;
    const std::string& cell = cells_[column];
    const auto [end, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
    if (error != std::errc{} || end != cell.data() + cell.size() || !(std::abs(value) <= most)) {
      refuse("a cell cannot be used", "a number from " + std::to_string(-most) + " to " + std::to_string(most), cell);
    }
    return value;
  }

 private:
  [[noreturn]] void refuse(std::string what, std::string expected, std::string found) const {
    throw Error(ErrorCode::Usage, {.what = std::move(what),
                                   .where = file_ + ":" + std::to_string(line_),
                                   .expected = std::move(expected),
                                   .found = std::move(found)});
  }
  const std::string file_;
  std::istream& stream_;
  std::size_t columns_ = 0, line_ = 1;
  std::vector<std::string> cells_;
};

}  // namespace

std::vector<SurveySecond> read_survey(const std::filesystem::path& file) {
  auto stream = open(file);
  return read_survey(stream, file.string());
}

std::vector<SurveySecond> read_survey(std::istream& stream, const std::string& name) {
  Rows rows(stream, name, "walk,second,x,y,level,beacon,rssi_dbm");
  std::map<std::string, std::uint32_t> walks;
  std::map<std::pair<std::uint32_t, std::int64_t>, SurveySecond> seconds;
  while (rows.next()) {
    const std::uint32_t walk = walks.try_emplace(rows.text(0), static_cast<std::uint32_t>(walks.size())).first->second;
    SurveySecond& second = seconds[{walk, static_cast<std::int64_t>(rows.number(1, kMostTime))}];
    second.walk = walk;
    second.x_m = rows.number(2, kFarthest_m);
    second.y_m = rows.number(3, kFarthest_m);
    second.level = static_cast<int>(rows.number(4, kHighestLevel));
    if (!rows.text(5).empty())
      second.rssi_dbm[normalised_id(rows.text(5))] = static_cast<float>(rows.number(6, kMostRssi_dbm));
  }
  std::vector<SurveySecond> result;
  for (auto& [key, second] : seconds) result.push_back(std::move(second));
  return result;
}

std::vector<TrackRow> read_tracks(const std::filesystem::path& file) {
  auto stream = open(file);
  return read_tracks(stream, file.string());
}

std::vector<TrackRow> read_tracks(std::istream& stream, const std::string& name) {
  Rows rows(stream, name, "track,t_ms,beacon,rssi_dbm");
  std::vector<TrackRow> result;
  while (rows.next()) {
    result.push_back({rows.text(0), static_cast<std::int64_t>(rows.number(1, kMostTime)), rows.text(2),
                      rows.number(3, kMostRssi_dbm)});
  }
  return result;
}

}  // namespace fiona::beacons
