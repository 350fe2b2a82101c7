#include "fiona/hull_probes.hpp"

#include <algorithm>

#include "fiona/hull.hpp"
#include "fiona/tap.hpp"

namespace fiona {
namespace {

using Of = HullProbe::Of;
using Value = std::optional<HullProbe::Value>;

double milliseconds(Duration duration) { return 1e3 * to_seconds(duration); }

Value count(const std::atomic<std::uint64_t>& counter) {
  return static_cast<std::int64_t>(counter.load(std::memory_order_relaxed));
}
Value age(const Hull& hull, Port* port, const Task*) {
  const auto age = port->counters().age(hull.clock().now());
  return age ? Value(milliseconds(*age)) : std::nullopt;
}
Value port_queue(const Hull&, Port* port, const Task*) {
  Inbox* inbox = port->inbox();
  return inbox ? Value(static_cast<std::int64_t>(inbox->depth())) : std::nullopt;
}

/// Of a required port with alternatives; null otherwise.
const RequiredPort* chooser(const Port* port) {
  const auto* required = dynamic_cast<const RequiredPort*>(port);
  return required && !required->alternatives().empty() ? required : nullptr;
}
Value serving(const Hull&, Port* port, const Task*) {
  const auto* required = chooser(port);
  if (!required) return std::nullopt;
  const auto all = required->alternatives();
  const auto found = std::find_if(all.begin(), all.end(), [](const auto& one) { return one.serves && one.fit; });
  return found == all.end() ? std::string() : found->provider;
}
Value flaps(const Hull&, Port* port, const Task*) {
  const auto* required = chooser(port);
  return required ? Value(static_cast<std::int64_t>(required->flaps())) : std::nullopt;
}

const HullProbe kProbes[] = {
    {Of::Instance, "mode", "string", "", "the mode it is in", nullptr},
    {Of::Instance, "last_error", "string", "", "why it failed; empty: it has not", nullptr},
    {Of::Instance, "handler_time", "double", "ms", "time spent in its handlers and tasks so far",
     [](const Hull& hull, Port*, const Task*) -> Value { return milliseconds(hull.strand().busy_time()); }},
    {Of::Instance, "cpu_time", "double", "ms", "CPU time that its handlers and tasks took so far",
     [](const Hull& hull, Port*, const Task*) -> Value { return milliseconds(hull.strand().cpu_time()); }},
    {Of::Instance, "queue_depth", "int64", "", "pieces of work that wait for its strand",
     [](const Hull& hull, Port*, const Task*) -> Value { return static_cast<std::int64_t>(hull.queue_depth()); }},
    {Of::Port, "rate", "double", "Hz", "messages a second, over the last second or so",
     [](const Hull& hull, Port* port, const Task*) -> Value {
       return port->counters().rate_now_hz(hull.clock().now());
     }},
    {Of::Port, "age", "double", "ms", "of the newest message", age},
    {Of::Port, "queue_depth", "int64", "", "messages that wait for the handler", port_queue},
    {Of::Port, "superseded", "int64", "", "overwritten by a newer one before anyone read them",
     [](const Hull&, Port* port, const Task*) { return count(port->counters().superseded); }},
    {Of::Port, "dropped", "int64", "", "lost to a full queue",
     [](const Hull&, Port* port, const Task*) { return count(port->counters().dropped); }},
    {Of::Port, "refused", "int64", "", "broke a rule of size, range or finiteness",
     [](const Hull&, Port* port, const Task*) { return count(port->counters().refused); }},
    {Of::Port, "not_active", "int64", "", "came in a mode that does not serve the port",
     [](const Hull&, Port* port, const Task*) { return count(port->counters().not_active); }},
    {Of::Port, "serving", "string", "", "of a port with alternatives: whose messages it gets; empty: none is fit",
     serving},
    {Of::Port, "flaps", "int64", "", "of a port with alternatives: how often who served was fit no longer", flaps},
    {Of::Task, "runs", "int64", "", "how often it ran",
     [](const Hull&, Port*, const Task* task) -> Value { return static_cast<std::int64_t>(task->runs()); }},
    {Of::Task, "overruns", "int64", "", "how often it should have started while it or the strand was busy",
     [](const Hull&, Port*, const Task* task) -> Value { return static_cast<std::int64_t>(task->overruns()); }},
    {Of::Task, "late", "double", "ms", "how long after what started it the last run began",
     [](const Hull&, Port*, const Task* task) -> Value { return milliseconds(task->late()); }},
};

template <class Carrier, class T>
std::shared_ptr<const Object> carry(T value) {
  auto object = std::make_shared<Carrier>();
  object->set_value(std::move(value));
  return object;
}

Envelope envelope_of(HullProbe::Value value, TimePoint now) {
  Envelope envelope{nullptr, 1, now, 0};
  if (auto* number = std::get_if<double>(&value)) envelope.object = carry<probe::Number>(*number);
  if (auto* integer = std::get_if<std::int64_t>(&value)) envelope.object = carry<probe::Integer>(*integer);
  if (auto* text = std::get_if<std::string>(&value)) envelope.object = carry<probe::Text>(std::move(*text));
  envelope.bytes = envelope.object->ByteSizeLong();
  return envelope;
}

}  // namespace

std::span<const HullProbe> hull_probes() { return kProbes; }

// ---- what can be watched --------------------------------------------------------------------------------------

/// What a name means: a port that pushes, a probe that is told each value, or something that is read now and then.
struct Hull::TapPoint {
  detail::PushProvider* port = nullptr;
  detail::ProbeBase* probe = nullptr;
  const HullProbe* counted = nullptr;
  Port* of_port = nullptr;
  const Task* of_task = nullptr;

  std::optional<Envelope> sample(const Hull& hull) const {
    auto value = counted->read(hull, of_port, of_task);
    return value ? std::optional(envelope_of(std::move(*value), hull.clock().now())) : std::nullopt;
  }
};

Hull::TapPoint Hull::tap_point(std::string_view name) const {
  if (Port* port = find_port(name)) {
    if (auto* push = dynamic_cast<detail::PushProvider*>(port)) return {.port = push};
    throw Error(ErrorCode::Usage, {.what = port->full_name() + " does not push: there is nothing to watch",
                                   .where = port->full_name(),
                                   .expected = "a port of a push service, or a probe"});
  }
  if (auto* probe = find_probe(name)) return {.probe = probe};
  if (name == mode_probe_->name()) return {.probe = mode_probe_.get()};
  if (name == error_probe_->name()) return {.probe = error_probe_.get()};
  const std::size_t dot = name.rfind('.');
  const std::string_view of = dot == std::string_view::npos ? "" : name.substr(0, dot);
  const std::string_view last = dot == std::string_view::npos ? name : name.substr(dot + 1);
  Port* port = find_port(of);
  const auto task = std::find_if(tasks_.begin(), tasks_.end(), [of](const Task* one) { return one->name() == of; });
  for (const HullProbe& one : hull_probes()) {
    if (one.name != last || !one.read) continue;
    if (one.of == Of::Instance && of.empty()) return {.counted = &one};
    if (one.of == Of::Port && port && (one.read != port_queue || port->inbox()))
      return {.counted = &one, .of_port = port};
    if (one.of == Of::Task && task != tasks_.end()) return {.counted = &one, .of_task = *task};
  }
  const auto known = tappable_names();
  throw Error(ErrorCode::NotFound, {.what = "'" + name_ + "' has no port or probe '" + std::string(name) + "'",
                                    .next = "show " + name_,
                                    .near = nearest_names(name, known)});
}

std::vector<std::string> Hull::tappable_names() const {
  std::vector<std::string> names;
  for (const auto* probe : probes_) names.push_back(probe->name());
  for (const HullProbe& one : hull_probes()) {
    if (one.of == Of::Instance) names.emplace_back(one.name);
    for (std::size_t i = 0; one.of == Of::Port && i < ports_.size(); ++i)
      names.push_back(ports_[i]->name() + "." + std::string(one.name));
    for (std::size_t i = 0; one.of == Of::Task && i < tasks_.size(); ++i)
      names.push_back(tasks_[i]->name() + "." + std::string(one.name));
  }
  for (Port* port : ports_) {
    if (dynamic_cast<detail::PushProvider*>(port)) names.push_back(port->name());
  }
  return names;
}

std::string Hull::unit_of(std::string_view name) const {
  const TapPoint point = tap_point(name);
  if (point.probe) return point.probe->unit();
  return point.counted ? std::string(point.counted->unit) : "";
}

Envelope Hull::read(std::string_view name) const {
  const TapPoint point = tap_point(name);
  if (point.port) {
    throw Error(ErrorCode::Usage, {.what = point.port->full_name() + " is a port: it has no value of now",
                                   .expected = "a probe",
                                   .next = "watch " + point.port->full_name()});
  }
  if (point.probe) return point.probe->read();
  return point.sample(*this).value_or(Envelope{});
}

std::shared_ptr<Tap> Hull::tap(std::string_view name, TapTerms terms, std::shared_ptr<Watcher> watcher) {
  const TapPoint point = tap_point(name);
  const std::string full_name = name_ + "." + std::string(name);
  if (point.counted && terms.older_than > Duration::zero()) {
    throw Error(ErrorCode::Usage,
                {.what = full_name + " is never old: the hull reads it when it is asked",
                 .expected = "a port, or a probe that the component sets",
                 .next = point.of_port ? "watch " + name_ + "." + point.of_port->name() + ".age when above 1000" : ""});
  }
  const auto made = std::make_shared<Tap>(full_name, std::move(terms), side_strand(), std::move(watcher));
  {
    const std::lock_guard lock(taps_mutex_);
    taps_.push_back(made);
  }
  Tap::Sample sample;
  if (point.counted) sample = [this, point] { return point.sample(*this); };
  // First its value of now, or it would be old, and none, where this thread stands still in between.
  if (point.port) point.port->attach(made);
  if (point.probe) point.probe->attach(made);
  made->start(std::move(sample));
  return made;
}

void Hull::untap(const std::shared_ptr<Tap>& tap) {
  tap->stop();
  for (Port* port : ports_) {
    if (auto* push = dynamic_cast<detail::PushProvider*>(port)) push->detach(*tap);
  }
  for (auto* probe : probes_) probe->detach(*tap);
  mode_probe_->detach(*tap);
  error_probe_->detach(*tap);
  const std::lock_guard lock(taps_mutex_);
  std::erase(taps_, tap);
}

void Hull::end_taps() {
  std::vector<std::shared_ptr<Tap>> ended;
  {
    const std::lock_guard lock(taps_mutex_);
    ended.swap(taps_);
  }
  for (const auto& tap : ended) {
    tap->end(Error(ErrorCode::NotFound,
                   {.what = "'" + name_ + "' was unloaded", .where = name_, .next = "load it again, or undo"}));
  }
  for (const auto& tap : ended) untap(tap);
}

// ---- what the hull tells by itself ----------------------------------------------------------------------------

void Hull::TextProbe::set(std::string text) {
  if (text_ == text) return;
  change(now(), [&] { text_ = std::move(text); });
}

std::shared_ptr<const Object> Hull::TextProbe::value() const { return carry<probe::Text>(*text_); }

/// One at a time, and what is true then: the last word is right whoever speaks it.
void Hull::tell_mode() {
  const std::lock_guard lock(tell_mutex_);
  error_probe_->set(reason());
  mode_probe_->set(mode());
}

}  // namespace fiona
