#include "table.hpp"

#include <algorithm>

#include "inert.hpp"

namespace fiona::console {

std::vector<std::string> Table::lines(bool header) const {
  std::vector<std::vector<std::string>> texts;
  if (header) texts.push_back(headers_);
  for (const auto& row : rows_) {
    auto& line = texts.emplace_back();
    for (const Cell& cell : row) line.push_back(cell.text.empty() ? "-" : inert(cell.text));
  }
  for (std::size_t i = 0; i < headers_.size(); ++i) {
    const auto is_empty = [i](const auto& row) { return i >= row.size() || row[i].text.empty(); };
    if (headers_[i] != rare_ || !std::all_of(rows_.begin(), rows_.end(), is_empty)) continue;
    for (auto& line : texts) line.erase(line.begin() + static_cast<std::ptrdiff_t>(std::min(i, line.size() - 1)));
    break;
  }
  std::vector<std::size_t> widths(headers_.size());
  for (const auto& line : texts) {
    for (std::size_t i = 0; i < line.size(); ++i) widths[i] = std::max(widths[i], display_width(line[i]));
  }
  std::vector<std::string> lines;
  for (const auto& line : texts) {
    std::string out;
    for (std::size_t i = 0; i < line.size(); ++i) {
      out += line[i];
      if (i + 1 < line.size()) out.append(widths[i] - display_width(line[i]) + 2, ' ');
    }
    lines.push_back(std::move(out));
  }
  return lines;
}

std::vector<nlohmann::json> Table::objects() const {
  std::vector<nlohmann::json> objects;
  for (const auto& row : rows_) {
    auto& object = objects.emplace_back(nlohmann::json::object());
    for (std::size_t i = 0; i < row.size(); ++i) object[headers_[i]] = row[i].value;
  }
  return objects;
}

}  // namespace fiona::console
