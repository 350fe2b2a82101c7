#pragma once

#include <fiona/error.hpp>

namespace fiona::tuf {

/// Throws the Error. What came from a repository may stand in it: each character that must not reach a terminal becomes
/// '?', and each text ends after 300 bytes.
[[noreturn]] void refuse(ErrorCode code, ErrorText text);

}  // namespace fiona::tuf
