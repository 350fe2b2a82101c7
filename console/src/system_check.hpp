#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "catalogue.hpp"
#include "shape.hpp"

namespace fiona::console {

/// What reading a system file against the known interfaces found. Nothing is started.
struct CheckResult {
  std::vector<LineError> errors;     ///< in the order of the lines
  std::vector<std::string> remarks;  ///< what could not be checked, and why
  struct Spot {
    std::string port;
    std::string service;
    bool optional = false;
    std::vector<std::string> could;  ///< provided ports of the file that would fit
  };
  std::vector<Spot> spots;  ///< required ports that the file leaves without a wire
  std::size_t lines = 0;
  std::size_t instances = 0;
};

/// Checks a file: grammar, plugins, instances, ports, contracts, parameters, modes; goes on after an error. Throws
/// fiona::Error only where the file itself cannot be read.
CheckResult check_system(const std::filesystem::path& file, const Catalogue& catalogue);

/// The same for a text; `origin` names it in errors.
CheckResult check_text(std::string_view text, const std::string& origin, const Catalogue& catalogue);

}  // namespace fiona::console
