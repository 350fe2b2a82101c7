#pragma once

#include <filesystem>
#include <string_view>

namespace fiona::records {

/// Where a component keeps what must outlive it: $XDG_STATE_HOME/fiona/NAME, else ~/.local/state/fiona/NAME. Throws
/// Error (Failed) where neither is set: nothing is kept in a place that nobody would look in.
std::filesystem::path data_file(std::string_view name);

}  // namespace fiona::records
