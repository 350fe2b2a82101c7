#pragma once

#include <string>
#include <vector>

#include "session.hpp"

namespace fiona::console {

/// The line that makes this change.
std::string line_of(const control::Change& change);

/// Makes what a line asks for, or adds it to the batch that collects; `otherwise` is said where the host says nothing.
void make(Session& session, const Line& line, control::Change change, const std::string& otherwise);

/// Makes the batch as one transaction. `whole`: it stands for the whole system, and this one becomes equal to it.
void make(Session& session, const Batch& batch, bool whole);

/// Says what was done, or what would be; `place` is of the line in a file, for warnings.
void tell(Session& session, const control::Reply& reply, const std::string& otherwise, const std::string& place = "");

}  // namespace fiona::console
