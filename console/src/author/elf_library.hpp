#pragma once

#include <filesystem>
#include <set>
#include <string>
#include <vector>

namespace fiona::console {

/// A symbol that a library takes from others.
struct NeededSymbol {
  std::string name;
  std::string version;  ///< "GLIBC_2.34"; empty: any
};

/// What a shared library says of itself, read from the file and not loaded.
struct ElfLibrary {
  std::string machine;  ///< as manifests spell it: "x86_64", "aarch64"; else the number of the ELF header
  std::vector<std::string> libraries;  ///< that it needs: "libc.so.6"
  std::vector<NeededSymbol> needed;    ///< not those that it can do without
  std::set<std::string> defined;
};

/// Throws fiona::Error (Failed) for a file that is no 64-bit shared library, or a damaged one.
ElfLibrary read_elf(const std::filesystem::path& file);

/// The needed symbols that neither the platform's libraries have, as they are in this process, nor those brought along.
std::vector<NeededSymbol> missing_symbols(const ElfLibrary& library, const std::set<std::string>& brought);

/// Whether every host has it: libfiona, protobuf, and the compiler's and the system's own libraries.
bool is_platform_library(const std::string& name);

}  // namespace fiona::console
