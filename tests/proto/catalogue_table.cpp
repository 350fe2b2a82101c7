#include <algorithm>
#include <fstream>
#include <stdexcept>

#include "catalogue.hpp"

namespace fiona::catalogue {
namespace {

constexpr std::string_view kHeader = "area,service,pattern,role,object,attribute,type,unit,description,decision";
constexpr std::size_t kColumns = 10;

// RFC 4180 without line breaks in a cell: the table has none.
std::vector<std::string> split_line(std::string_view line) {
  std::vector<std::string> cells(1);
  bool quoted = false;
  for (std::size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (c == '"' && quoted && i + 1 < line.size() && line[i + 1] == '"') {
      cells.back() += line[++i];
    } else if (c == '"') {
      quoted = !quoted;
    } else if (c == ',' && !quoted) {
      cells.emplace_back();
    } else {
      cells.back() += c;
    }
  }
  return cells;
}

std::map<std::string, std::string> split_decision(const std::string& text, const std::string& where) {
  std::map<std::string, std::string> decision;
  for (std::size_t begin = 0; begin < text.size();) {
    const std::size_t end = std::min(text.find("; ", begin), text.size());
    const std::string item = text.substr(begin, end - begin);
    const std::size_t equals = item.find('=');
    const std::string key = item.substr(0, equals);
    if (key != "type" && key != "unit" && key != "fields" && key != "meaning") {
      throw std::runtime_error(where + ": decision \"" + key + "\" is none of type, unit, fields, meaning");
    }
    decision[key] = equals == std::string::npos ? "" : item.substr(equals + 1);
    begin = end + 2;
  }
  return decision;
}

Row make_row(const std::vector<std::string>& cells, std::size_t line, const std::string& where) {
  if (cells.size() != kColumns) {
    throw std::runtime_error(where + ": " + std::to_string(cells.size()) + " columns, expected " +
                             std::to_string(kColumns));
  }
  return Row{line,
             cells[0],
             cells[1],
             cells[2],
             cells[3],
             cells[4],
             cells[5],
             cells[6],
             cells[7],
             cells[8],
             split_decision(cells[9], where)};
}

}  // namespace

std::vector<Row> read_table(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line) || line != kHeader) {
    throw std::runtime_error(path + ": line 1: expected the header \"" + std::string(kHeader) + "\"");
  }
  std::vector<Row> rows;
  for (std::size_t number = 2; std::getline(file, line); ++number) {
    rows.push_back(make_row(split_line(line), number, path + ": line " + std::to_string(number)));
  }
  return rows;
}

const std::vector<std::string>& areas() {
  static const std::vector<std::string> names = {"sensors",    "perception", "localisation",
                                                 "navigation", "security",   "hmi"};
  return names;
}

}  // namespace fiona::catalogue
