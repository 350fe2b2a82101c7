// What a refusal says.
#pragma once

#include <functional>
#include <string>

#include "fiona/error.hpp"

namespace fiona::tests {

/// The whole text of the Error that `act` throws; "no error" if it throws none.
inline std::string error_of(const std::function<void()>& act) {
  try {
    act();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

}  // namespace fiona::tests
