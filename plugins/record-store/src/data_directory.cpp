#include "fiona/records/data_directory.hpp"

#include <cstdlib>

#include "fiona/error.hpp"

namespace fiona::records {
namespace {

std::filesystem::path variable(const char* name) {
  const char* value = std::getenv(name);
  return value ? value : "";
}

}  // namespace

std::filesystem::path data_file(std::string_view name) {
  if (const auto state = variable("XDG_STATE_HOME"); state.is_absolute()) return state / "fiona" / name;
  if (const auto home = variable("HOME"); home.is_absolute()) return home / ".local/state/fiona" / name;
  throw Error(ErrorCode::Failed, {.what = "there is no place for " + std::string(name),
                                  .expected = "XDG_STATE_HOME or HOME in the environment",
                                  .next = "set the component's parameter 'database'"});
}

}  // namespace fiona::records
