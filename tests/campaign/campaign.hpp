#pragma once

#include <sys/types.h>

#include <vector>

#include "system.hpp"

namespace fiona::conformance {

/// How much of something a campaign asks for, from the environment.
int number_from(const char* variable, int otherwise);

/// What all processes of the test hold.
struct Holdings {
  long descriptors = 0;
  double resident_mib = 0;
};

Holdings holdings(const std::vector<pid_t>& processes);
std::vector<pid_t> processes(host::System& system);

}  // namespace fiona::conformance
