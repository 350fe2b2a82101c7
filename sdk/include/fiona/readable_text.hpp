#pragma once

#include <string>
#include <string_view>

namespace fiona {

/// Text of a component or of another process as a message may carry it, for one that is no UTF-8 (RFC 3629) is not read
/// at all: what is none is U+FFFD in its place. At most so many bytes, and never a part of a character.
std::string readable_text(std::string_view text, std::size_t most = std::string_view::npos);

}  // namespace fiona
