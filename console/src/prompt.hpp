#pragma once

#include "session.hpp"

namespace fiona::console {

struct PromptOptions {
  bool started_host = false;  ///< this process started the host: leaving asks whether to stop it
  bool let_run = false;       ///< a virtual clock runs while the prompt is there
  /// Whether a host that has gone will be back though this process started it; none: it will not.
  std::function<bool()> comes_back{};
};

/// Reads lines from the terminal until `quit` or Ctrl-D, with history and completion; other output appears above the
/// line being typed. `session.finished` is set where the host was told to end. Throws fiona::Error (Unreachable) where
/// the host goes away.
void run_prompt(Session& session, const PromptOptions& options);

}  // namespace fiona::console
