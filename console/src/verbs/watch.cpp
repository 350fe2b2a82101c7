#include "../watch_list.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "verbs.hpp"

namespace fiona::console::verbs {
namespace {

void stop(Session& session, const Line& line) {
  const std::string port = line.positional.size() > 1 ? line.positional[1].text : "";
  const std::vector<std::string> running = session.watches().ports();
  const std::size_t stopped = session.watches().stop(port);
  if (!port.empty() && stopped == 0) {
    throw line.error(line.positional[1],
                     {.what = fmt::format("'{}' is not watched here", port),
                      .found = fmt::format("{}", fmt::join(running, ", ")),
                      .near = nearest_names(port, running)},
                     ErrorCode::NotFound);
  }
  session.out.done(fmt::format("stopped {} watch{}", stopped, stopped == 1 ? "" : "es"), {{"stopped", stopped}});
}

}  // namespace

void watch(Session& session, const Line& line) {
  if (line.positional[0].is_plain("stop")) return stop(session, line);
  WatchRequest request;
  request.port = port_name(line.positional[0], line.words);
  for (std::size_t i = 1; i < line.positional.size(); ++i) request.fields.push_back(line.positional[i].text);
  if (const Word* every = line.clause("every")) request.every_ms = duration_ms(*every, line.words);
  if (const Word* over = line.clause("for")) request.for_ms = duration_ms(*over, line.words);
  session.watches().start(request);
  if (session.setting != Setting::Shell) return;
  session.reactor.run_until([&session] { return session.watches().empty() || !session.connected(); });
  if (!session.watches().empty())
    throw Error(ErrorCode::Unreachable, ErrorText{.what = "the host has gone", .where = line.positional[0].text});
}

}  // namespace fiona::console::verbs
