#pragma once

#include <cstdint>

#include "fiona/abi.hpp"

namespace fiona {

/// What `fiona_messages_entry` of a shared message library returns: a struct of C, version first. fiona_add_messages()
/// writes that function.
struct MessagesEntry {
  std::uint32_t size;              ///< of this struct
  std::uint32_t edge_version;      ///< 1
  const char* abi;                 ///< `FIONA_ABI_TAG` of the SDK that the library was built with
  const char* const* proto_files;  ///< that it brings, as imports spell them; null after the last
};

inline constexpr std::uint32_t kMessagesEdgeVersion = 1;
inline constexpr const char* kMessagesEntrySymbol = "fiona_messages_entry";

}  // namespace fiona
