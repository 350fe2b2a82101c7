#include "table.hpp"

#include <algorithm>
#include <numeric>

#include "inert.hpp"

namespace fiona::console {
namespace {

using Row = std::vector<std::string>;

constexpr std::size_t kBetween = 2;
/// A column of text is not made narrower: it would be a ladder of words.
constexpr std::size_t kLeastText = 16;

std::vector<std::string> words_in_cell(const std::string& text) {
  std::vector<std::string> words;
  for (std::size_t from = 0; from <= text.size();) {
    const std::size_t blank = std::min(text.find(' ', from), text.size());
    words.push_back(text.substr(from, blank - from));
    from = blank + 1;
  }
  return words;
}

/// The text in lines of at most so many columns, or of one word.
std::vector<std::string> broken(const std::string& text, std::size_t columns) {
  std::vector<std::string> lines;
  if (display_width(text) <= columns) return {text};
  for (const std::string& word : words_in_cell(text)) {
    const bool fits = !lines.empty() && display_width(lines.back()) + 1 + display_width(word) <= columns;
    if (fits)
      lines.back() += " " + word;
    else
      lines.push_back(word);
  }
  return lines;
}

std::size_t width_of(const std::vector<std::size_t>& widths) {
  return std::accumulate(widths.begin(), widths.end(), kBetween * (widths.size() - 1));
}

/// How wide each column is, `narrow`: as narrow as it may become.
std::vector<std::size_t> widths_of(const std::vector<Row>& texts, bool narrow) {
  std::vector<std::size_t> widths;
  for (const Row& line : texts) {
    widths.resize(std::max(widths.size(), line.size()));
    for (std::size_t i = 0; i < line.size(); ++i) {
      std::size_t least = narrow ? std::min(display_width(line[i]), kLeastText) : display_width(line[i]);
      if (narrow) {
        for (const std::string& word : words_in_cell(line[i])) least = std::max(least, display_width(word));
      }
      widths[i] = std::max(widths[i], least);
    }
  }
  return widths;
}

/// The widest gives way first.
void make_narrower(std::vector<std::size_t>& widths, const std::vector<std::size_t>& least, std::size_t columns) {
  while (width_of(widths) > columns) {
    std::size_t widest = widths.size();
    for (std::size_t i = 0; i < widths.size(); ++i) {
      if (widths[i] > least[i] && (widest == widths.size() || widths[i] > widths[widest])) widest = i;
    }
    if (widest == widths.size()) return;
    --widths[widest];
  }
}

/// A row, as high as its highest text.
void add_row(std::vector<std::string>& lines, const Row& row, const std::vector<std::size_t>& widths) {
  std::vector<std::vector<std::string>> cells;
  std::size_t height = 1;
  for (std::size_t i = 0; i < row.size(); ++i) {
    cells.push_back(broken(row[i], widths[i]));
    height = std::max(height, cells.back().size());
  }
  for (std::size_t at = 0; at < height; ++at) {
    std::string out;
    std::size_t begin = 0;  // of the column; what is before it may be shorter
    for (std::size_t i = 0; i < cells.size(); ++i) {
      if (at < cells[i].size()) {
        out.append(begin - std::min(begin, display_width(out)), ' ');
        out += cells[i][at];
      }
      begin += widths[i] + kBetween;
    }
    lines.push_back(std::move(out));
  }
}

std::vector<std::string> paragraphs(const std::vector<Row>& texts, std::size_t columns) {
  std::size_t heads = 0;
  for (const std::string& head : texts.front()) heads = std::max(heads, display_width(head));
  const std::vector<std::size_t> widths{heads, columns - std::min(columns - 1, heads + kBetween)};
  std::vector<std::string> lines;
  for (std::size_t row = 1; row < texts.size(); ++row) {
    if (row > 1) lines.emplace_back();
    for (std::size_t i = 0; i < texts[row].size(); ++i) add_row(lines, {texts[0][i], texts[row][i]}, widths);
  }
  return lines;
}

}  // namespace

/// What is shown to people: without the rare column where it is empty.
std::vector<Table::Row> Table::texts(bool header) const {
  std::vector<Row> texts;
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
  return texts;
}

std::vector<std::string> Table::lines(bool header, std::size_t columns) const {
  const std::vector<Row> shown = texts(header);
  if (shown.empty()) return {};
  std::vector<std::size_t> widths = widths_of(shown, false);
  if (columns > 0 && width_of(widths) > columns) {
    make_narrower(widths, widths_of(shown, true), columns);
    if (header && shown.size() > 1 && width_of(widths) > columns) return paragraphs(shown, columns);
  }
  std::vector<std::string> lines;
  for (const Row& line : shown) add_row(lines, line, widths);
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
