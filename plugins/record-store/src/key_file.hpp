#pragma once

#include <array>
#include <filesystem>

namespace fiona::records {

using Key = std::array<unsigned char, 32>;

/// Reads the key in `file`. Throws Error (Failed) if it is not there or not whole.
Key read_key(const std::filesystem::path& file);

/// Makes a key, and FILE.next for it that is its owner's alone and is whole on the disk when this returns. Throws Error
/// (Failed).
Key make_key(const std::filesystem::path& file);

/// FILE.next becomes FILE, if it is there. Throws Error (Failed).
void adopt_key(const std::filesystem::path& file);

}  // namespace fiona::records
