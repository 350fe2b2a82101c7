#pragma once

#include <signal.h>
#include <sys/wait.h>

namespace fiona::conformance {

/// Stops a child process, and returns when it stands: the signal alone leaves it some time.
inline void stop_process(pid_t process) {
  ::kill(process, SIGSTOP);
  siginfo_t seen{};
  ::waitid(P_PID, static_cast<id_t>(process), &seen, WSTOPPED | WNOWAIT);
}

}  // namespace fiona::conformance
