#pragma once

#include <cstdlib>
#include <string>

namespace fiona::tests {

/// Processes that are started from now on end by a signal, or for want of memory, as they do without AddressSanitizer;
/// what it reports has no names, which take it a second.
inline void end_as_without_sanitizer() {
  const char* already = std::getenv("ASAN_OPTIONS");
  const std::string options = already == nullptr ? "" : already;
  if (options.find("handle_segv=0") != std::string::npos) return;
  const std::string more = "handle_segv=0:handle_sigbus=0:abort_on_error=1:allocator_may_return_null=0:symbolize=0";
  ::setenv("ASAN_OPTIONS", (options + ":" + more).c_str(), 1);
}

}  // namespace fiona::tests
