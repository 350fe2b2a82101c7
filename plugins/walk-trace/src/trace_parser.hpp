#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>

#include <fiona/walk/walk.hpp>

namespace fiona::walk {

/// Builds one walk from the lines of its file. Throws fiona::Error naming `where` and the line.
class TraceParser {
 public:
  /// `where`: archive and entry, for errors. `level`: of the floor's folder; empty when way-points carry their own.
  TraceParser(std::string where, std::optional<int> level, std::size_t most_events);

  void line(std::string_view text);
  Walk finish();

 private:
  using Fields = struct FieldList;

  void header(std::string_view text);
  void row(const Fields& fields);
  EventData parse(const Fields& fields, std::int64_t t_ms);
  EventData wifi(const Fields& fields, std::int64_t t_ms);
  EventData beacon(const Fields& fields);
  EventData way_point(const Fields& fields);
  double number(const Fields& fields, std::size_t index, const char* meaning) const;
  std::int64_t integer(const Fields& fields, std::size_t index, const char* meaning) const;
  void need(const Fields& fields, std::size_t least, std::size_t most, const char* expected) const;
  std::int64_t integer_within(const Fields& fields, std::size_t index, const char* meaning, std::int64_t least,
                              std::int64_t most) const;
  std::uint32_t transmitter(std::string_view name);
  std::uint32_t identity(BeaconIdentity beacon);
  [[noreturn]] void fail(const std::string& what, const std::string& expected, std::string_view found) const;

  std::string where_;
  std::optional<int> level_;
  std::size_t most_events_;
  std::size_t line_number_ = 0;
  Walk walk_;
  std::unordered_map<std::string, std::uint32_t> transmitter_index_;
  std::map<BeaconIdentity, std::uint32_t> beacon_index_;
};

}  // namespace fiona::walk
