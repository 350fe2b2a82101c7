#pragma once

#include <cstdint>
#include <string>
#include <type_traits>

#include "fiona/control.pb.h"

namespace fiona::detail {

/// A number that an int64 cannot hold keeps all its digits, as they would be typed.
void set_natural(control::Value& value, std::uint64_t number);

/// A flag, a number, a text, or the name of an enumerator, as a line of the console holds it.
template <class T>
control::Value typed_value(const T& value) {
  control::Value typed;
  if constexpr (std::is_same_v<T, bool>) {
    typed.set_flag(value);
  } else if constexpr (std::is_integral_v<T> && std::is_unsigned_v<T>) {
    set_natural(typed, value);
  } else if constexpr (std::is_integral_v<T>) {
    typed.set_integer(static_cast<std::int64_t>(value));
  } else if constexpr (std::is_floating_point_v<T>) {
    typed.set_number(value);
  } else {
    typed.set_text(std::string(value));
  }
  return typed;
}

}  // namespace fiona::detail
