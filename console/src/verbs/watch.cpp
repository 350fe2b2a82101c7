#include "../watch_list.hpp"

#include <map>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "../system_view.hpp"
#include "../types.hpp"
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

constexpr std::string_view kConditions =
    "[FIELD] above VALUE, [FIELD] below VALUE, [FIELD] is VALUE, changes, older than T";

/// `above 3`, `speed above 3`, `is failed`, `changes`, `older than 1s`.
control::Condition condition_of(const std::vector<Word>& words, const Line& line) {
  static const std::map<std::string, control::Comparison> kCompared{
      {"above", control::GREATER}, {"below", control::LESS}, {"is", control::EQUAL}};
  control::Condition condition;
  const auto text = [&words](std::size_t i) { return i < words.size() ? words[i].text : ""; };
  if (text(0) == "changes" && words.size() == 1) {
    condition.set_changes(true);
    return condition;
  }
  if (text(0) == "older" && text(1) == "than" && words.size() == 3) {
    condition.set_older_than_ms(duration_ms(words[2], line.words));
    return condition;
  }
  const std::size_t at = kCompared.contains(text(0)) && words.size() == 2 ? 0 : 1;
  const auto compared = kCompared.find(text(at));
  if (compared == kCompared.end() || words.size() != at + 2) {
    throw line.error(words.front(), {.what = fmt::format("'{}' is no condition", words.front().text),
                                     .expected = std::string(kConditions),
                                     .next = "help watch"});
  }
  if (at == 1) condition.set_field(words[0].text);
  condition.mutable_compared()->set_comparison(compared->second);
  *condition.mutable_compared()->mutable_value() = value_of(words[at + 1], line.words);
  return condition;
}

/// A time where it has a unit, else a count.
void take_every(WatchRequest& request, const Word& every, const Line& line) {
  if (value_of(every, line.words).kind_case() == control::Value::kInteger &&
      value_of(every, line.words).unit().empty()) {
    request.every_nth = count_of(every, line.words);
  } else {
    request.every_ms = duration_ms(every, line.words);
  }
}

}  // namespace
}  // namespace fiona::console::verbs

namespace fiona::console {

WatchRequest watch_request(const Line& line) {
  WatchRequest request;
  request.port = watched_name(line.positional[0], line.words);
  for (std::size_t i = 1; i < line.positional.size(); ++i) request.fields.push_back(line.positional[i].text);
  if (const Word* every = line.clause("every")) verbs::take_every(request, *every, line);
  if (line.clause("when") != nullptr) request.when = verbs::condition_of(line.clauses.at("when"), line);
  if (const Word* over = line.clause("for")) request.for_ms = duration_ms(*over, line.words);
  return request;
}

}  // namespace fiona::console

namespace fiona::console::verbs {
namespace {

/// The type of what the port or probe says, or its service; empty: it says nothing that has fields, or is not known.
std::string watched_type(Session& session, const control::PortName& name) {
  const control::System system = session.snapshot();
  const auto* instance = find_instance(system, name.instance());
  if (instance == nullptr) return {};
  if (const auto* port = find_port(*instance, name.port())) {
    const bool pushes = port->pattern() == fiona::PUSH_NEWEST || port->pattern() == fiona::PUSH_TIMED;
    return pushes ? port->service() : std::string();
  }
  for (const ProbeInfo& probe : probes_of(*instance)) {
    if (probe.name == name.port() && probe.type.find('.') != std::string::npos) return probe.type;
  }
  return {};
}

/// Before the port says anything, which it may never do. What cannot be told now, its first message tells.
void check_fields(Session& session, const WatchRequest& request, const Line& line) {
  std::vector<Word> fields(line.positional.begin() + 1, line.positional.end());
  if (request.when && !request.when->field().empty()) fields.push_back(line.clauses.at("when").front());
  if (fields.empty()) return;
  const std::string type_name = watched_type(session, request.port);
  if (type_name.empty()) return;
  control::Request describe;
  describe.mutable_describe()->set_name(type_name);
  control::Reply reply;
  try {
    reply = session.call(std::move(describe));
  } catch (const Error& problem) {
    if (problem.code() == ErrorCode::NotFound) return;
    throw;
  }
  const TypeSet types(reply.description().files());
  const auto* type = types.object(reply.description().name());
  const auto* service = reply.description().is_service() ? types.service(reply.description().name()) : nullptr;
  if (service != nullptr && service->method_count() > 0) type = service->method(0)->output_type();
  if (type == nullptr) return;
  for (const Word& field : fields) {
    const PathCheck checked = check_path(*type, field.text);
    if (checked.exists) continue;
    throw line.error(field,
                     {.what = fmt::format("there is no field '{}' in {}", field.text, type->name()),
                      .expected = fmt::format("{}", fmt::join(checked.known, ", ")),
                      .near = nearest_names(field.text, checked.known)},
                     ErrorCode::NotFound);
  }
}

}  // namespace

void watch(Session& session, const Line& line) {
  if (line.positional[0].is_plain("stop")) return stop(session, line);
  const WatchRequest request = watch_request(line);
  check_fields(session, request, line);
  session.watches().start(request);
  if (session.setting != Setting::Shell) return;
  session.watches().wait(WatchList::Which::All);
}

}  // namespace fiona::console::verbs
