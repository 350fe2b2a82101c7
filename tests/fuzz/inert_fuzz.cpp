// Whatever comes in, what goes to the terminal is UTF-8 on one line, without control characters, and a second time
// nothing changes.
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "inert.hpp"

using namespace fiona::console;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string once = inert({reinterpret_cast<const char*>(data), size});
  if (inert(once) != once) std::abort();
  if (display_width(once) > once.size()) std::abort();  // a code point of two columns has three bytes
  for (std::string_view rest = once; !rest.empty();) {
    const Character next = decode(rest);
    const bool control = next.code < 0x20 || (next.code >= 0x7f && next.code < 0xa0) ||
                         (next.code >= 0x202a && next.code <= 0x202e) || (next.code >= 0x2066 && next.code <= 0x2069);
    if (!next.valid || control) std::abort();
    rest.remove_prefix(next.bytes);
  }
  return 0;
}
