#pragma once

#include <string>

namespace fiona::console {

/// fiona(1) and fiona-system(5) in man's macros (groff_man(7)), from the same table as parser, help and completion.
std::string command_manual(const std::string& version);
std::string system_file_manual(const std::string& version);

}  // namespace fiona::console
