#pragma once

#include <string>
#include <vector>

#include "fiona/control.pb.h"

namespace fiona::console {

/// What is wrong with one instance or port.
struct Finding {
  std::string thing;    ///< "phone", "nav.location"
  std::string state;    ///< "failed: the file ends in line 12"
  double since_s = -1;  ///< for how long; negative: not known
  std::string next;     ///< the line to type; empty: the one before it has to be mended
};

/// Why an instance does not do its work: each of its ports' chains, and its own trouble. The root first, what it leads
/// to behind it, each once; empty: nothing is wrong with it or with what it needs.
std::vector<Finding> findings_of(const control::System& system, const control::InstanceStatus& instance);

/// Likewise for one port: why nothing comes from it (provided) or to it (required), or why nobody answers there.
std::vector<Finding> findings_of(const control::System& system, const control::InstanceStatus& instance,
                                 const control::PortStatus& port);

}  // namespace fiona::console
