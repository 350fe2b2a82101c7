#pragma once

#include <cstdint>
#include <string_view>

namespace fiona::marketplace {

/// The role that speaks for the index; no publisher can have this name.
inline constexpr std::string_view kIndexRole = "fiona.index";

inline constexpr std::uint64_t kMostIndexFileBytes = std::uint64_t{64} << 20;

}  // namespace fiona::marketplace
