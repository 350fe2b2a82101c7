#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "fiona/error.hpp"

namespace fiona::planning {

enum class Text : std::uint8_t { Domain, Problem };

/// A place in one of the two texts of a planning problem; lines and columns (in bytes) count from 1.
struct Place {
  Text text = Text::Domain;
  std::uint32_t line = 0;
  std::uint32_t column = 0;

  std::string to_string() const;
};

/// The place of the byte at `offset`.
Place place_of(Text which, std::string_view text, std::size_t offset);

/// What is wrong with a text, and where.
class PddlError final : public Error {
 public:
  PddlError(Place place, ErrorText text);

  const Place& place() const { return place_; }
  /// One line: "domain 3:14: the predicate 'att' is not declared; did you mean 'at'".
  std::string sentence() const;

 private:
  Place place_;
};

}  // namespace fiona::planning
