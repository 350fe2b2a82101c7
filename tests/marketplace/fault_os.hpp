#pragma once

#include <cerrno>
#include <fiona/marketplace/os_calls.hpp>
#include <functional>

namespace fiona::marketplace::testing {

template <typename Result, typename... Arguments>
void guard(std::function<Result(Arguments...)>& call, const std::function<int()>& before) {
  call = [before, real = call](Arguments... arguments) -> Result {
    if (const int error = before(); error != 0) {
      errno = error;
      return -1;
    }
    return real(arguments...);
  };
}

/// The system's calls, with `before` asked first at each: a value other than 0 is the errno to fail with
/// instead.
inline OsCalls guarded_calls(const std::function<int()>& before) {
  OsCalls os = system_calls();
  guard(os.create, before);
  guard(os.write, before);
  guard(os.fsync, before);
  guard(os.mkdir, before);
  guard(os.rename, before);
  guard(os.unlink, before);
  guard(os.flock, before);
  return os;
}

}  // namespace fiona::marketplace::testing
