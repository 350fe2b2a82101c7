#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace fiona::console {

/// Rows for people and for programs at once: aligned columns of text, or one JSON object a row with the headers as
/// keys. Plain text with two blanks between columns, which a screen reader reads in order.
class Table {
 public:
  struct Cell {
    std::string text;      ///< for people: "50 Hz"
    nlohmann::json value;  ///< for programs: 50.0

    Cell(std::string both) : text(both), value(std::move(both)) {}  // NOLINT: a row is a list of texts mostly
    Cell(const char* both) : Cell(std::string(both)) {}             // NOLINT
    Cell(std::string shown, nlohmann::json meant) : text(std::move(shown)), value(std::move(meant)) {}
  };

  explicit Table(std::vector<std::string> headers) : headers_(std::move(headers)) {}

  /// Programs always have this column, people while it says something.
  void leave_out_if_empty(const std::string& header) { rare_ = header; }
  void add(std::vector<Cell> row) { rows_.push_back(std::move(row)); }
  bool empty() const { return rows_.empty(); }
  std::size_t size() const { return rows_.size(); }

  /// The lines, inert, the header first; trailing blanks are cut. Without `header` only the rows. On a terminal of so
  /// many `columns` (0: it is none) the texts of a table that is wider are broken between words, each in its column;
  /// where that does not do, each row becomes a paragraph, a line for each column, headed by its name.
  std::vector<std::string> lines(bool header = true, std::size_t columns = 0) const;
  std::vector<nlohmann::json> objects() const;

 private:
  using Row = std::vector<std::string>;
  std::vector<Row> texts(bool header) const;

  std::vector<std::string> headers_;
  std::string rare_;
  std::vector<std::vector<Cell>> rows_;
};

}  // namespace fiona::console
