#pragma once

#include <sys/types.h>

#include <filesystem>
#include <string>

namespace fiona::conformance {

/// What is in a file; of one in /proc, nothing once its process has gone.
std::string content_of(const std::filesystem::path& file);

/// What a process and all that have come of it are doing right now, for a test that waits in vain: of each its words,
/// its threads with their states and what they wait for in the kernel, and, where gdb is installed, where in the
/// program. A program that gdb looks at stands still meanwhile.
std::string evidence_of(pid_t process);

}  // namespace fiona::conformance
