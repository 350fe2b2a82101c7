#pragma once

#include <string>

#include "completion.hpp"
#include "session.hpp"

namespace fiona::console {

/// As much of a typed line as may be kept: it ends where the first value of a field begins that is secret, or that may
/// be, because the line is not understood or nobody says which fields there are. Asks the host for those of a call, and
/// adds their names to what `session.out` knows.
std::string kept_part(const std::string& line, Session& session, Names& names);

}  // namespace fiona::console
