#include <filesystem>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "../watch_list.hpp"
#include "verbs.hpp"

namespace fiona::console {

std::vector<WatchRequest> record_requests(const Line& line) {
  std::vector<WatchRequest> requests;
  for (std::size_t i = 1; i < line.positional.size(); ++i) {
    WatchRequest& request = requests.emplace_back();
    request.port = watched_name(line.positional[i], line.words);
    if (const Word* over = line.clause("for")) request.for_ms = duration_ms(*over, line.words);
  }
  return requests;
}

}  // namespace fiona::console

namespace fiona::console::verbs {
namespace {

void stop_recording(Session& session, const Line& line) {
  const std::string file = line.positional.size() > 1 ? line.positional[1].text : "";
  const std::vector<std::string> running = session.watches().recordings();
  if (session.watches().stop_recording(file) > 0) return;
  if (file.empty()) return session.out.done("nothing is recorded here", {{"stopped", 0}});
  throw line.error(line.positional[1],
                   {.what = fmt::format("nothing is recorded into '{}' here", file),
                    .found = fmt::format("{}", fmt::join(running, ", ")),
                    .near = nearest_names(file, running)},
                   ErrorCode::NotFound);
}

/// All its ports are watched, or the file is not there.
void start_recording(Session& session, const Line& line) {
  std::vector<WatchRequest> requests = record_requests(line);
  session.host();
  const auto into = std::make_shared<Recording>(line.positional[0].text);
  std::vector<std::uint64_t> started;
  const auto leave_nothing = [&] {
    session.watches().give_up(started);
    std::error_code gone;
    std::filesystem::remove(into->file(), gone);
  };
  try {
    for (WatchRequest& request : requests) {
      request.into = into;
      started.push_back(session.watches().start(request));
    }
  } catch (const Error& problem) {
    leave_nothing();
    throw line.error(line.positional[started.size() + 1], problem.text(), problem.code());
  } catch (...) {
    leave_nothing();
    throw;
  }
}

/// Whoever records means it so; also twice.
void end_interrupted(Session& session, const std::string& file) {
  for (;;) {
    try {
      session.watches().stop_recording(file);
      return;
    } catch (const Interrupted&) {
    }
  }
}

}  // namespace

void record(Session& session, const Line& line) {
  if (line.positional[0].is_plain("stop")) return stop_recording(session, line);
  start_recording(session, line);
  if (session.setting != Setting::Shell) return;
  try {
    session.watches().wait(WatchList::Which::All);
  } catch (const Interrupted&) {
    end_interrupted(session, line.positional[0].text);
  }
}

}  // namespace fiona::console::verbs
