#include "watch_list.hpp"

#include <algorithm>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace fiona::console {

namespace {

constexpr std::chrono::milliseconds kLooksSoon{100}, kLooksAgain{500};
constexpr std::chrono::seconds kFlushEvery{1};

}  // namespace

std::uint64_t WatchList::start(const WatchRequest& request) {
  session_.host();  // a connection that is made again asks for those that are in the list
  const std::uint64_t number = ++last_;
  Running& watch = running_[number];
  watch.request = request;
  watch.name = request.port.instance() + "." + request.port.port();
  watch.manner_json = session_.out.manner.json;
  starting_ = number;
  try {
    ask(number, watch);
    // The host answers in order: what it refuses it has refused before it answers this.
    control::Request nothing;
    nothing.mutable_unwatch();
    session_.host().call(std::move(nothing));
  } catch (...) {
    starting_.reset();
    refused_.reset();
    give_up({number});
    throw;
  }
  starting_.reset();
  if (refused_) throw Error(*std::exchange(refused_, std::nullopt));
  if (request.for_ms) {
    const auto end_at =
        std::chrono::steady_clock::now() + std::chrono::microseconds(static_cast<std::int64_t>(*request.for_ms * 1000));
    watch.timer = session_.reactor.add_timer(end_at, [this, number] { end(number, true); });
  }
  return number;
}

/// Replies come in the reactor's waits only.
void WatchList::ask(std::uint64_t number, Running& watch) {
  control::Request message;
  *message.mutable_watch()->mutable_port() = watch.request.port;
  message.mutable_watch()->set_min_period_ms(watch.request.every_ms);
  message.mutable_watch()->set_prescale(watch.request.every_nth);
  if (watch.request.when) *message.mutable_watch()->mutable_condition() = *watch.request.when;
  watch.asked = session_.host().begin(std::move(message),
                                      [this, number](const control::Reply& reply) { arrived(number, reply); });
}

void WatchList::arrived(std::uint64_t number, const control::Reply& reply) {
  const auto found = running_.find(number);
  if (found == running_.end()) return;
  try {
    if (reply.has_failure()) throw_failure(reply.failure());
    if (reply.has_sample()) {
      Running& watch = found->second;
      if (!watch.lost.empty()) is_back(watch);
      ++watch.samples;
      watch.request.into ? record(watch, reply.sample()) : print(watch, reply.sample());
    }
    if (reply.has_done() && found->second.samples == 0 && !reply.done().note().empty())
      session_.out.remark(reply.done().note());
  } catch (const Error& problem) {
    if (reply.has_failure() && goes_on(number, found->second, problem)) return;
    if (number == starting_) {
      give_up({number});
      refused_ = problem;
      return;
    }
    end(number, !reply.has_failure());
    // In a shell the watch is the command, and its failure the command's; elsewhere it is news beside other lines.
    if (session_.setting == Setting::Shell) throw;
    session_.out.error(problem);
  }
}

/// What has been seen and is lost may come back: its group is started again, its host is connected again. What the host
/// says at the second time says whether that is so.
bool WatchList::goes_on(std::uint64_t number, Running& watch, const Error& problem) {
  const bool is_new = watch.lost.empty();
  const bool is_away = problem.code() == ErrorCode::Unreachable || (problem.code() == ErrorCode::NotFound && !is_new);
  if (!is_away || watch.samples == 0) return false;
  const std::string& why = problem.text().what;
  if (!is_new && why != watch.told) {
    watch.told = why;
    session_.out.remark(fmt::format("{}; the watch of {} goes on when it is back", why, watch.name));
  }
  watch.lost = why;
  watch.object.reset();
  watch.types.reset();
  session_.host().forget(watch.asked);
  const auto when = std::chrono::steady_clock::now() + (is_new ? kLooksSoon : kLooksAgain);
  watch.retry = session_.reactor.add_timer(when, [this, number] {
    const auto found = running_.find(number);
    if (found == running_.end()) return;
    found->second.retry.reset();
    if (session_.connected()) ask(number, found->second);
  });
  return true;
}

void WatchList::resume() {
  for (auto& [number, watch] : running_) {
    if (watch.retry) session_.reactor.cancel_timer(*std::exchange(watch.retry, std::nullopt));
    watch.object.reset();
    watch.types.reset();
    watch.lost = watch.told = "the host has gone";
    ask(number, watch);
  }
}

void WatchList::is_back(Running& watch) {
  if (watch.told.empty()) session_.out.remark(fmt::format("{}; the watch of {} goes on", watch.lost, watch.name));
  watch.lost.clear();
  watch.told.clear();
}

void WatchList::check_fields(const Running& watch) const {
  for (const std::string& field : watch.request.fields) {
    const PathCheck checked = check_path(*watch.object->GetDescriptor(), field);
    if (checked.exists) continue;
    throw Error(
        ErrorCode::NotFound,
        ErrorText{.what = fmt::format("there is no field '{}' in {}", field, watch.object->GetDescriptor()->name()),
                  .where = watch.name,
                  .expected = checked.known.empty() ? "" : fmt::format("{}", fmt::join(checked.known, ", ")),
                  .near = nearest_names(field, checked.known)});
  }
}

void WatchList::read(Running& watch, const control::Sample& sample) {
  if (!watch.object) {
    watch.types = std::make_unique<TypeSet>(sample.files());
    watch.object = watch.types->make(sample.type());
    if (!watch.object)
      throw Error(ErrorCode::Failed,
                  ErrorText{.what = fmt::format("the host did not describe the type {}", sample.type()),
                            .where = watch.name,
                            .next = "run the console of the same version as the host: fiona --version"});
    check_fields(watch);
  }
  if (!watch.object->ParseFromString(sample.object()))
    throw Error(ErrorCode::Failed, ErrorText{.what = fmt::format("a {} cannot be read", sample.type()),
                                             .where = watch.name,
                                             .next = "tell the component's publisher: market info tells who"});
}

std::string WatchList::text_of(const Running& watch, const control::Sample& sample) const {
  if (sample.type().empty()) return "no value yet";
  std::vector<std::string> parts;
  const bool is_plain = is_plain_value(sample.type());
  for (const FieldText& field :
       field_texts(*watch.object, watch.request.fields, Secrets::Hidden, session_.out.manner.verbose ? 1000 : 8)) {
    const std::string& unit = is_plain ? sample.unit() : field.unit;
    parts.push_back(
        fmt::format("{}{}{}{}", is_plain ? "" : field.path + " ", field.text, unit.empty() ? "" : " ", unit));
  }
  // An event that is missing is news; a sample that is, was left out as asked.
  if (watch.request.when && sample.skipped() > 0) parts.push_back(fmt::format("{} lost before it", sample.skipped()));
  return fmt::format("{}", fmt::join(parts, ", "));
}

void WatchList::print(Running& watch, const control::Sample& sample) {
  if (!sample.type().empty()) read(watch, sample);
  // The host counts `every` on the system's clock, which may run much faster than anybody reads. Half of it, so that
  // a sample that comes a little early is not lost.
  const auto now = std::chrono::steady_clock::now();
  const std::chrono::duration<double, std::milli> since = now - watch.printed;
  if (watch.samples > 1 && !watch.request.when && since.count() < watch.request.every_ms / 2) return;
  watch.printed = now;
  Output& out = session_.out;
  const Manner before = out.manner;
  out.manner.json = watch.manner_json;
  if (watch.manner_json) {
    out.object({{"watch", watch.name},
                {"sequence", sample.sequence()},
                {"time_s", sample.time_s()},
                {"age_ms", sample.age_ms()},
                {"skipped", sample.skipped()},
                {"type", sample.type()},
                {"unit", sample.unit()},
                {"object", sample.type().empty() ? nlohmann::json() : object_json(*watch.object)}});
  } else {
    out.text(fmt::format("{}  {:.3f} s  {}", watch.name, sample.time_s(), text_of(watch, sample)));
  }
  out.manner = before;
}

void WatchList::record(Running& watch, const control::Sample& sample) {
  const auto into = watch.request.into;
  if (!flush_timer_)
    flush_timer_ =
        session_.reactor.add_timer(std::chrono::steady_clock::now() + kFlushEvery, [this] { flush_recordings(); });
  try {
    into->take(watch.name, sample);
  } catch (const Error&) {
    abandon(*into);
    throw;
  }
}

/// Nothing more can be written: it ends as it is, for all its ports.
void WatchList::abandon(const Recording& broken) {
  std::vector<std::uint64_t> ports;
  for (const auto& [number, watch] : running_) {
    if (watch.request.into.get() == &broken) ports.push_back(number);
  }
  give_up(ports);
}

void WatchList::flush_recordings() {
  flush_timer_.reset();
  std::set<std::shared_ptr<Recording>> open;
  for (const auto& [number, watch] : running_) {
    if (watch.request.into) open.insert(watch.request.into);
  }
  for (const auto& recording : open) {
    try {
      recording->flush();
    } catch (const Error& problem) {
      abandon(*recording);
      if (session_.setting == Setting::Shell) throw;
      session_.out.error(problem);
    }
  }
}

void WatchList::finish(Recording& recording) {
  recording.finish();
  const McapWriter& written = recording.written();
  const double seconds = static_cast<double>(written.last_ns() - written.first_ns()) / 1e9;
  const std::string lost =
      recording.lost() > 0 ? fmt::format("; {} were lost, for this console was slow", recording.lost()) : "";
  session_.out.done(
      fmt::format("recorded {} message{} of {} port{} in {:.1f} s: {}, {:.0f} kB{}", written.messages(),
                  written.messages() == 1 ? "" : "s", recording.ports(), recording.ports() == 1 ? "" : "s", seconds,
                  recording.file(), static_cast<double>(written.bytes()) / 1e3, lost),
      {{"file", recording.file()},
       {"messages", written.messages()},
       {"ports", recording.ports()},
       {"seconds", seconds},
       {"bytes", written.bytes()},
       {"lost", recording.lost()}});
}

void WatchList::stop_timers(Running& watch) {
  if (watch.timer) session_.reactor.cancel_timer(*watch.timer);
  if (watch.retry) session_.reactor.cancel_timer(*watch.retry);
}

void WatchList::end(std::uint64_t number, bool tell_host) {
  const auto found = running_.find(number);
  if (found == running_.end()) return;
  stop_timers(found->second);
  const std::uint64_t asked = found->second.asked;
  const auto into = std::move(found->second.request.into);
  running_.erase(found);
  const bool goes_on = std::any_of(running_.begin(), running_.end(),
                                   [&into](const auto& one) { return one.second.request.into == into; });
  if (into && !goes_on) finish(*into);
  if (!session_.connected()) return;
  session_.host().forget(asked);
  if (!tell_host) return;
  control::Request request;
  request.mutable_unwatch()->set_watch(asked);
  session_.host().tell(std::move(request));
}

void WatchList::give_up(const std::vector<std::uint64_t>& numbers) {
  for (const std::uint64_t number : numbers) {
    if (const auto found = running_.find(number); found != running_.end()) found->second.request.into.reset();
  }
  for (const std::uint64_t number : numbers) end(number, true);
}

std::size_t WatchList::stop(const std::string& port) {
  std::vector<std::uint64_t> ended;
  for (const auto& [number, watch] : running_) {
    if (!watch.request.into && (port.empty() || watch.name == port)) ended.push_back(number);
  }
  for (const std::uint64_t number : ended) end(number, true);
  return ended.size();
}

std::size_t WatchList::stop_recording(const std::string& file) {
  std::size_t stopped = 0;
  for (const std::string& one : recordings()) {
    if (!file.empty() && one != file) continue;
    ++stopped;
    std::vector<std::uint64_t> ended;
    for (const auto& [number, watch] : running_) {
      if (watch.request.into && watch.request.into->file() == one) ended.push_back(number);
    }
    for (const std::uint64_t number : ended) end(number, true);
  }
  return stopped;
}

void WatchList::wait(Which which) {
  const auto over = [this, which] {
    return std::none_of(running_.begin(), running_.end(), [which](const auto& one) {
      return which == Which::All || one.second.request.for_ms.has_value();
    });
  };
  session_.reactor.run_until([this, &over] { return over() || !session_.connected(); });
  if (!over())
    throw Error(ErrorCode::Unreachable,
                ErrorText{.what = "the host has gone",
                          .where = running_.begin()->second.name,
                          .next = "start it again; one that comes back by itself: fiona run --supervised"});
}

void WatchList::clear() {
  std::set<std::shared_ptr<Recording>> recordings;
  for (auto& [number, watch] : running_) {
    stop_timers(watch);
    if (watch.request.into) recordings.insert(std::move(watch.request.into));
  }
  running_.clear();
  for (const auto& recording : recordings) {
    try {
      finish(*recording);
    } catch (const std::exception& problem) {
      session_.out.remark(problem.what());
    }
  }
}

std::vector<std::string> WatchList::ports() const {
  std::vector<std::string> names;
  for (const auto& [number, watch] : running_) {
    if (!watch.request.into) names.push_back(watch.name);
  }
  return names;
}

std::vector<std::string> WatchList::recordings() const {
  std::set<std::string> files;
  for (const auto& [number, watch] : running_) {
    if (watch.request.into) files.insert(watch.request.into->file());
  }
  return {files.begin(), files.end()};
}

}  // namespace fiona::console
