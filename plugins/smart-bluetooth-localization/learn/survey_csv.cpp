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

class Rows {
 public:
  Rows(const std::filesystem::path& file, const std::string& header) : file_(file.string()), stream_(file) {
    if (!stream_) throw Error(ErrorCode::NotFound, {.what = "the file cannot be read", .where = file_});
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
  double number(std::size_t column) const {
    double value = 0;
    const std::string& cell = cells_[column];
    const auto [end, error] = std::from_chars(cell.data(), cell.data() + cell.size(), value);
    if (error != std::errc{} || end != cell.data() + cell.size() || !std::isfinite(value) || std::abs(value) > 1e15) {
      refuse("a cell is no number", "a number", cell);
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
  std::ifstream stream_;
  std::size_t columns_ = 0, line_ = 1;
  std::vector<std::string> cells_;
};

}  // namespace

std::vector<SurveySecond> read_survey(const std::filesystem::path& file) {
  Rows rows(file, "walk,second,x,y,level,beacon,rssi_dbm");
  std::map<std::string, std::uint32_t> walks;
  std::map<std::pair<std::uint32_t, std::int64_t>, SurveySecond> seconds;
  while (rows.next()) {
    const std::uint32_t walk = walks.try_emplace(rows.text(0), static_cast<std::uint32_t>(walks.size())).first->second;
    SurveySecond& second = seconds[{walk, static_cast<std::int64_t>(rows.number(1))}];
    second.walk = walk;
    second.x_m = rows.number(2);
    second.y_m = rows.number(3);
    second.level = static_cast<int>(rows.number(4));
    if (!rows.text(5).empty()) second.rssi_dbm[normalised_id(rows.text(5))] = static_cast<float>(rows.number(6));
  }
  std::vector<SurveySecond> result;
  for (auto& [key, second] : seconds) result.push_back(std::move(second));
  return result;
}

std::vector<TrackRow> read_tracks(const std::filesystem::path& file) {
  Rows rows(file, "track,t_ms,beacon,rssi_dbm");
  std::vector<TrackRow> result;
  while (rows.next()) {
    result.push_back({rows.text(0), static_cast<std::int64_t>(rows.number(1)), rows.text(2), rows.number(3)});
  }
  return result;
}

}  // namespace fiona::beacons
