#include "watch_list.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace fiona::console {

std::uint64_t WatchList::start(const WatchRequest& request) {
  control::Request message;
  *message.mutable_watch()->mutable_port() = request.port;
  message.mutable_watch()->set_min_period_ms(request.every_ms);
  message.mutable_watch()->set_prescale(request.every_nth);
  if (request.when) *message.mutable_watch()->mutable_condition() = *request.when;
  const auto number = std::make_shared<std::uint64_t>(0);
  // The entry exists before any reply can be served: replies come in the reactor's waits only.
  *number = session_.host().begin(std::move(message),
                                  [this, number](const control::Reply& reply) { arrived(*number, reply); });
  Running& watch = running_[*number];
  watch.request = request;
  watch.name = request.port.instance() + "." + request.port.port();
  watch.manner_json = session_.out.manner.json;
  if (request.for_ms) {
    const auto end_at =
        std::chrono::steady_clock::now() + std::chrono::microseconds(static_cast<std::int64_t>(*request.for_ms * 1000));
    watch.timer = session_.reactor.add_timer(end_at, [this, id = *number] { end(id, true); });
  }
  return *number;
}

void WatchList::arrived(std::uint64_t id, const control::Reply& reply) {
  const auto found = running_.find(id);
  if (found == running_.end()) return;
  try {
    if (reply.has_failure()) throw_failure(reply.failure());
    if (reply.has_sample()) print(found->second, reply.sample());
    if (reply.has_done() && found->second.samples == 0 && !reply.done().note().empty())
      session_.out.remark(reply.done().note());
  } catch (const Error& problem) {
    end(id, !reply.has_failure());
    // In a shell the watch is the command, and its failure the command's; elsewhere it is news beside other lines.
    if (session_.setting == Setting::Shell) throw;
    session_.out.error(problem);
  }
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
       field_texts(*watch.object, watch.request.fields, session_.out.manner.verbose ? 1000 : 8)) {
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
  ++watch.samples;
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

void WatchList::end(std::uint64_t id, bool tell_host) {
  const auto found = running_.find(id);
  if (found == running_.end()) return;
  if (found->second.timer) session_.reactor.cancel_timer(*found->second.timer);
  running_.erase(found);
  if (!session_.connected()) return;
  session_.host().forget(id);
  if (!tell_host) return;
  control::Request request;
  request.mutable_unwatch()->set_watch(id);
  session_.host().tell(std::move(request));
}

std::size_t WatchList::stop(const std::string& port) {
  std::vector<std::uint64_t> ended;
  for (const auto& [id, watch] : running_) {
    if (port.empty() || watch.name == port) ended.push_back(id);
  }
  for (const std::uint64_t id : ended) end(id, true);
  return ended.size();
}

void WatchList::clear() {
  for (auto& [id, watch] : running_) {
    if (watch.timer) session_.reactor.cancel_timer(*watch.timer);
  }
  running_.clear();
}

std::vector<std::string> WatchList::ports() const {
  std::vector<std::string> names;
  for (const auto& [id, watch] : running_) names.push_back(watch.name);
  return names;
}

}  // namespace fiona::console
