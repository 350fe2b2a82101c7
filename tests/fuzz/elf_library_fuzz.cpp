// The bytes of shared libraries: any bytes are read or refused with one fiona::Error, and nothing of them is loaded.
#include <sys/mman.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <string>

#include <fiona/error.hpp>

#include "author/elf_library.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const int file = ::memfd_create("fuzz", MFD_CLOEXEC);
  if (file < 0) return 0;
  if (::write(file, data, size) == static_cast<ssize_t>(size)) {
    try {
      const auto library = fiona::console::read_elf("/proc/self/fd/" + std::to_string(file));
      fiona::console::missing_symbols(library, library.defined);
    } catch (const fiona::Error&) {
    }
  }
  ::close(file);
  return 0;
}
