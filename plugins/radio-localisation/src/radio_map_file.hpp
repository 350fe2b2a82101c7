#pragma once

#include <cstdint>
#include <filesystem>
#include <string_view>

#include "radio_map.hpp"

namespace fiona::radio {

/// Version of the file format that this build writes and reads.
inline constexpr std::uint32_t kRadioMapVersion = 2;

/// Writes the map as one file: beside the target first, then renamed, so that a reader sees the old map or the new.
/// Throws fiona::Error with the system's reason when the disk refuses.
void save(const RadioMap& map, const std::filesystem::path& file);

/// Throws the same where a file of that name could not be written: told before minutes are spent on what goes there.
void check_writable(const std::filesystem::path& file);

/// Reads a map. Throws fiona::Error: NotFound when there is no such file; Failed when it is no radio map, is of another
/// version, is truncated or garbled (a checksum covers every byte). Memory stays within that of the largest rasters
/// (kMostSquares) and a few times the file's size.
RadioMap load(const std::filesystem::path& file);

/// The map in the bytes of a file; `file` names them in errors.
RadioMap parse(std::string_view bytes, const std::filesystem::path& file);

}  // namespace fiona::radio
