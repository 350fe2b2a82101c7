// fiona-supervisor: starts fiona-host with the arguments that it is given itself, and starts it again when it has
// ended. People start it through `fiona run --supervised`.
#include <fcntl.h>
#include <signal.h>
#include <sys/signalfd.h>

#include <exception>
#include <iostream>
#include <string>

#include "fiona/tool.hpp"
#include "os/unread.hpp"
#include "supervisor.hpp"

namespace {

using fiona::host::Supervisor;

int signals_as_descriptor() {
  sigset_t ending;
  sigemptyset(&ending);
  sigaddset(&ending, SIGINT);
  sigaddset(&ending, SIGTERM);
  sigprocmask(SIG_BLOCK, &ending, nullptr);
  return ::signalfd(-1, &ending, SFD_CLOEXEC | SFD_NONBLOCK);
}

/// What is not for it is for the host.
Supervisor::Options options_from(int argc, char** argv) {
  Supervisor::Options options{.host = fiona::os::program_directory() / "fiona-host"};
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const bool has_value = i + 1 < argc;
    if (word == "--ready-fd" && has_value) {
      options.ready = fiona::os::Descriptor(std::stoi(argv[++i]));
    } else if (word == "--lifeline-fd" && has_value) {
      options.lifeline = fiona::os::Descriptor(std::stoi(argv[++i]));
    } else if (word == "--hang-after-ms" && has_value) {
      options.hang = std::chrono::milliseconds(std::stoi(argv[++i]));
    } else if (word == "--after-end" && has_value) {
      options.after_end = argv[++i];
    } else {
      options.arguments.push_back(word);
    }
  }
  return options;
}

}  // namespace

int main(int argc, char** argv) {
  fiona::open_standard_streams();
  // Whoever reads what it says may go first. A handler, unlike SIG_IGN, is not handed down to the host.
  ::signal(SIGPIPE, [](int) {});
  fiona::os::wait_for_no_reader();
  try {
    auto options = options_from(argc, argv);
    for (const int one : {options.ready.get(), options.lifeline.get()}) {
      if (one >= 0) ::fcntl(one, F_SETFD, FD_CLOEXEC);
    }
    Supervisor supervisor(std::move(options));
    return supervisor.run(signals_as_descriptor());
  } catch (const std::exception& error) {
    std::cerr << "fiona-supervisor: " << error.what() << "\n";
    return 1;
  }
}
