#include "taps.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>

#include "failure.hpp"
#include "field_compare.hpp"
#include "fiona/error.hpp"
#include "fiona/readable_text.hpp"
#include "fiona/secrets.hpp"
#include "names.hpp"

namespace fiona::host {
namespace {

wire::Tapped tapped_of(const Envelope& envelope, const std::string& unit, TimePoint now) {
  wire::Tapped tapped;
  tapped.set_unit(unit);
  tapped.set_sequence(envelope.sequence);
  tapped.set_origin_ns(envelope.origin.time_since_epoch().count());
  tapped.set_told_ns(now.time_since_epoch().count());
  if (!envelope.object) return tapped;
  tapped.set_type(envelope.object->GetDescriptor()->full_name());
  const WithoutSecrets shown(*envelope.object);
  if (const auto* word = dynamic_cast<const probe::Text*>(&*shown)) {
    probe::Text readable;  // of any bytes that a component takes for text
    readable.set_value(readable_text(word->value(), kMostCopied));
    readable.SerializeToString(tapped.mutable_object());
  } else {
    shown->SerializeToString(tapped.mutable_object());
  }
  return tapped;
}

/// Of what the hull samples each value is work, which no watch is to fill a thread with.
constexpr double kLeastPeriod_ms = 1;

TapTerms terms_of(const control::Watch& watch, const std::string& unit) {
  using Condition = control::Condition;
  TapTerms terms;
  terms.every = std::max(1U, watch.prescale());
  if (watch.min_period_ms() > 0) terms.period = from_milliseconds(std::max(kLeastPeriod_ms, watch.min_period_ms()));
  const Condition& condition = watch.condition();
  terms.changes = condition.kind_case() == Condition::kChanges;
  if (condition.kind_case() == Condition::kOlderThanMs) {
    if (!(condition.older_than_ms() > 0))
      throw Error(ErrorCode::Usage, {.what = "an age is above zero", .expected = "older than 500ms, for example"});
    terms.older_than = from_milliseconds(condition.older_than_ms());
  }
  if (condition.kind_case() == Condition::kCompared) {
    terms.holds = [condition, unit](const Object& object) {
      const auto& compared = condition.compared();
      return compare_field(object, condition.field(), compared.comparison(), compared.value(), unit).first;
    };
  }
  return terms;
}

constexpr std::size_t kLongestText = 200;

std::string value_text(const Object& object) {
  std::string text;
  if (const auto* number = dynamic_cast<const probe::Number*>(&object)) {
    text = fmt::format("{:.6g}", number->value());
  } else if (const auto* integer = dynamic_cast<const probe::Integer*>(&object)) {
    text = fmt::format("{}", integer->value());
  } else if (const auto* flag = dynamic_cast<const probe::Flag*>(&object)) {
    text = flag->value() ? "true" : "false";
  } else if (const auto* word = dynamic_cast<const probe::Text*>(&object)) {
    text = word->value();
  } else {
    text = object.ShortDebugString();
  }
  return readable_text(text, kLongestText) + (text.size() > kLongestText ? "…" : "");
}

}  // namespace

/// Passes values on to the host, as bytes, until one is too large for that.
class Taps::Teller final : public Watcher {
 public:
  Teller(const wire::Tap& tap, std::string unit, const Clock& clock, const OnEvent& on_event)
      : id_(tap.tap()),
        opening_(tap.opening()),
        name_(text_of(tap.watch().port())),
        unit_(std::move(unit)),
        clock_(clock),
        on_event_(on_event) {}

  void value(const Tapped& value) override {
    if (ended_) return;
    if (const std::size_t bytes = bytes_of(value.envelope); bytes > kMostCopied) {
      return ended(Error(ErrorCode::Failed, {.what = "what " + name_ + " says is too large to be watched",
                                             .where = name_,
                                             .expected = fmt::format("at most {} bytes", kMostCopied),
                                             .found = std::to_string(bytes),
                                             .next = "watch a probe of it, or wire it to who says less"}));
    }
    wire::GroupMessage message;
    auto& tapped = *message.mutable_tapped();
    tapped = tapped_of(value.envelope, unit_, clock_.now());
    tapped.set_tap(id_);
    tapped.set_opening(opening_);
    tapped.set_number(value.number);
    tapped.set_skipped(value.skipped);
    on_event_(std::move(message));
  }
  void ended(const Error& why) override {
    if (ended_.exchange(true)) return;
    wire::GroupMessage message;
    message.mutable_tap_ended()->set_tap(id_);
    *message.mutable_tap_ended()->mutable_failure() = failure_of(why);
    on_event_(std::move(message));
  }

 private:
  static std::size_t bytes_of(const Envelope& envelope) {
    return envelope.object ? envelope.object->ByteSizeLong() : 0;
  }

  const std::uint64_t id_;
  const std::uint64_t opening_;
  const std::string name_;
  const std::string unit_;
  const Clock& clock_;
  const OnEvent& on_event_;
  std::atomic<bool> ended_{false};
};

void Taps::tap(const wire::Tap& request, Hull& hull) {
  const std::string& name = request.watch().port().port();
  const std::string unit = hull.unit_of(name);
  const auto alike = std::count_if(taps_.begin(), taps_.end(), [&](const auto& one) {
    return one.second.hull == &hull && one.second.name == name && !one.second.is_own;
  });
  if (!request.is_own() && alike >= static_cast<std::ptrdiff_t>(kMostOfOne)) {
    throw Error(ErrorCode::Failed, {.what = fmt::format("it is watched, or waited for, {} times already", alike),
                                    .where = text_of(request.watch().port()),
                                    .expected = fmt::format("at most {} times at once", kMostOfOne),
                                    .next = "watch stop, where it is not needed"});
  }
  auto teller = std::make_shared<Teller>(request, unit, hull.clock(), on_event_);
  taps_[request.tap()] = {&hull, name, hull.tap(name, terms_of(request.watch(), unit), std::move(teller)),
                          request.is_own()};
}

void Taps::untap(std::uint64_t id) {
  const auto found = taps_.find(id);
  if (found == taps_.end()) return;
  found->second.hull->untap(found->second.tap);
  taps_.erase(found);
}

void Taps::clear() {
  while (!taps_.empty()) untap(taps_.begin()->first);
}

void Taps::release(const Hull& hull) {
  std::erase_if(taps_, [&hull](const auto& entry) { return entry.second.hull == &hull; });
}

void push_event(Mailbox<wire::GroupMessage>& events, wire::GroupMessage event) {
  if (event.has_tap_ended()) {
    const std::uint64_t tap = event.tap_ended().tap();
    return events.push_last(tap, std::move(event));
  }
  if (!event.has_tapped()) return events.push(std::move(event));
  const std::uint64_t tap = event.tapped().tap();
  const std::size_t bytes = event.tapped().object().size();
  events.push_newest(tap, std::move(event), bytes);
}

wire::Tapped read_probe(const Hull& hull, const std::string& name) {
  return tapped_of(hull.read(name), hull.unit_of(name), hull.clock().now());
}

void fill_probes(control::InstanceStatus& status, const Hull& hull, TimePoint now) {
  for (const auto* probe : hull.probes()) {
    auto& one = *status.add_probes();
    one.set_name(probe->name());
    one.set_type(probe->type());
    one.set_unit(probe->unit());
    one.set_doc(probe->doc());
    one.set_age_ms(-1);
    const Envelope value = probe->read();
    if (!value.object) continue;
    one.set_value(value_text(*WithoutSecrets(*value.object)));
    one.set_age_ms(std::max(0.0, 1e3 * to_seconds(now - value.origin)));
  }
}

}  // namespace fiona::host
