#include "comparison.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "failure.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/options.pb.h"
#include "model.hpp"

namespace fiona::host {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;

namespace {

constexpr std::size_t kDeepest = 8;

bool is_fraction(const FieldDescriptor& field) {
  const auto type = field.cpp_type();
  return !field.is_repeated() && (type == FieldDescriptor::CPPTYPE_DOUBLE || type == FieldDescriptor::CPPTYPE_FLOAT);
}

/// The full turn, where the field declares one as its range.
double circle_of(const FieldDescriptor& field) {
  const auto& options = field.options();
  const std::string& unit = options.GetExtension(fiona::unit);
  const double turn = unit == "rad" ? 2 * std::numbers::pi : unit == "deg" ? 360 : 0;
  if (turn == 0 || !options.HasExtension(fiona::min) || !options.HasExtension(fiona::max)) return 0;
  const double range = options.GetExtension(fiona::max) - options.GetExtension(fiona::min);
  return std::abs(range - turn) < 1e-3 * turn ? turn : 0;
}

double value_of(const Message& part, const FieldDescriptor& field) {
  const auto& reflect = *part.GetReflection();
  return field.cpp_type() == FieldDescriptor::CPPTYPE_FLOAT ? reflect.GetFloat(part, &field)
                                                            : reflect.GetDouble(part, &field);
}

/// Null where a part on the way is not there.
const Message* part_of(const Message& object, const std::vector<const FieldDescriptor*>& path) {
  const Message* part = &object;
  for (const auto* field : path) {
    const auto& reflect = *part->GetReflection();
    if (!reflect.HasField(*part, field)) return nullptr;
    part = &reflect.GetMessage(*part, field);
  }
  return part;
}

bool is_valid(const Message& object) {
  const auto* field = object.GetDescriptor()->FindFieldByName("is_valid");
  const bool says = field && field->cpp_type() == FieldDescriptor::CPPTYPE_BOOL && !field->is_repeated();
  return !says || object.GetReflection()->GetBool(object, field);
}

std::string prefix_of(const std::vector<const FieldDescriptor*>& path) {
  std::string text;
  for (const auto* field : path) text += field->name() + ".";
  return text;
}

}  // namespace

void Distances::add(double distance) {
  most_ = std::max(most_, distance);
  if (count_++ % stride_ != 0) return;
  kept_.push_back(distance);
  if (kept_.size() < kMostKept) return;
  for (std::size_t i = 0; 2 * i < kept_.size(); ++i) kept_[i] = kept_[2 * i];
  kept_.resize(kept_.size() / 2);
  stride_ *= 2;
}

double Distances::median() const {
  if (kept_.empty()) return 0;
  std::vector<double> sorted = kept_;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  return *middle;
}

std::optional<double> Comparison::Field::between(const Message& a, const Message& b) const {
  const Message* one = part_of(a, path);
  const Message* other = part_of(b, path);
  if (!one || !other) return std::nullopt;
  double squares = 0;
  for (const auto* field : coordinates) {
    const bool has = !field->has_presence() ||
                     (one->GetReflection()->HasField(*one, field) && other->GetReflection()->HasField(*other, field));
    if (!has) return std::nullopt;
    double difference = std::abs(value_of(*one, *field) - value_of(*other, *field));
    if (circle > 0) difference = std::min(difference, std::abs(circle - difference));
    squares += difference * difference;
  }
  return std::sqrt(squares);
}

void Comparison::collect(const Descriptor& type, std::vector<const FieldDescriptor*> path, std::vector<Field>& fields) {
  const std::string prefix = prefix_of(path);
  const std::size_t first = fields.size();
  std::vector<std::string> frames;
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (!is_fraction(field)) continue;
    const std::string& unit = field.options().GetExtension(fiona::unit);
    const double circle = circle_of(field);
    // Coordinates: of one frame, in one unit, and no angles.
    const std::string frame = circle > 0 || unit.empty() ? "" : field.options().GetExtension(fiona::frame);
    std::size_t at = first;
    while (at < fields.size() && (frame.empty() || frames[at - first] != frame || fields[at].unit != unit)) ++at;
    if (at == fields.size()) {
      fields.push_back({.path = path, .name = prefix + field.name(), .unit = unit, .circle = circle});
      frames.push_back(frame);
    }
    fields[at].coordinates.push_back(&field);
  }
  bool named = false;
  for (std::size_t at = first; at < fields.size(); ++at) {
    auto& one = fields[at];
    if (one.coordinates.size() == 1) continue;
    const std::string part = prefix.empty() ? "" : prefix.substr(0, prefix.size() - 1) + " ";
    one.name = part + "distance";
    if (std::exchange(named, true)) one.name += " of " + one.coordinates.front()->name();
  }
  if (path.size() >= kDeepest) return;
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (field.is_repeated() || field.cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE) continue;
    auto deeper = path;
    deeper.push_back(&field);
    collect(*field.message_type(), std::move(deeper), fields);
  }
}

void Comparison::add(const control::PortName& old, std::uint64_t old_tap, const control::PortName& next,
                     std::uint64_t next_tap) {
  Pair& pair = pairs_.emplace_back();
  pair.old.name = old;
  pair.old.tap = old_tap;
  pair.next.name = next;
  pair.next.tap = next_tap;
}

void Comparison::take(Pair& pair, Side& side, const wire::Tapped& tapped) {
  ++side.messages;
  std::shared_ptr<Message> object = types_.make(tapped.type());
  if (!object || !object->ParseFromString(tapped.object()) || !is_valid(*object)) return;
  ++side.valid;
  side.newest = std::move(object);
  if (!pair.first) {
    pair.first = side.newest;
    collect(*pair.first->GetDescriptor(), {}, pair.fields);
  }
  // A new one is set against what the old one said last; the other way round each would count twice.
  if (&side == &pair.old || !pair.old.newest) return;
  const auto is_compared = [&pair](const Side& one) {
    return one.newest->GetDescriptor() == pair.first->GetDescriptor();
  };
  if (!is_compared(pair.old) || !is_compared(pair.next)) return;
  for (Field& field : pair.fields) {
    if (const auto distance = field.between(*pair.old.newest, *pair.next.newest)) field.distances.add(*distance);
  }
}

std::optional<control::Failure> Comparison::note(const wire::GroupMessage& event) {
  for (Pair& pair : pairs_) {
    for (Side* side : {&pair.old, &pair.next}) {
      if (event.has_tapped() && event.tapped().tap() == side->tap && !event.tapped().type().empty())
        take(pair, *side, event.tapped());
    }
    const std::string& next = pair.next.name.instance();
    const bool failed = event.has_mode_changed() && event.mode_changed().instance() == next &&
                        event.mode_changed().mode() == kModeFailed;
    const bool ended = event.has_tap_ended() && event.tap_ended().tap() == pair.next.tap;
    if (!failed && !ended) continue;
    return failure_of(Error(ErrorCode::ComponentFailed,
                            {.what = "'" + next + "' ended while it was compared: nothing was swapped",
                             .where = next,
                             .found = failed ? event.mode_changed().reason() : event.tap_ended().failure().what(),
                             .next = "show " + next}));
  }
  return std::nullopt;
}

std::optional<control::Failure> Comparison::objection() const {
  for (const Pair& pair : pairs_) {
    if (pair.next.valid > 0 || pair.old.valid == 0) continue;
    const std::string next = text_of(pair.next.name);
    const std::string said = pair.next.messages == 0
                                 ? " said nothing"
                                 : fmt::format(" said {} times that it is not valid", pair.next.messages);
    return failure_of(Error(ErrorCode::Failed, {.what = next + said + " while it was compared: nothing was swapped",
                                                .where = next,
                                                .expected = fmt::format("what {} said {} times meanwhile",
                                                                        text_of(pair.old.name), pair.old.valid),
                                                .next = "show " + pair.next.name.instance()}));
  }
  return std::nullopt;
}

std::vector<control::Agreement> Comparison::agreements() const {
  std::vector<control::Agreement> all;
  for (const Pair& pair : pairs_) {
    auto& one = all.emplace_back();
    *one.mutable_old() = pair.old.name;
    *one.mutable_next() = pair.next.name;
    one.set_old_messages(pair.old.messages);
    one.set_next_messages(pair.next.messages);
    one.set_old_valid(pair.old.valid);
    one.set_next_valid(pair.next.valid);
    for (const Field& field : pair.fields) {
      if (field.distances.count() == 0) continue;
      auto& difference = *one.add_differences();
      difference.set_field(field.name);
      difference.set_unit(field.unit);
      difference.set_median(field.distances.median());
      difference.set_most(field.distances.most());
      difference.set_compared(field.distances.count());
    }
  }
  return all;
}

std::vector<std::uint64_t> Comparison::taps() const {
  std::vector<std::uint64_t> all;
  for (const Pair& pair : pairs_) {
    all.push_back(pair.old.tap);
    all.push_back(pair.next.tap);
  }
  return all;
}

}  // namespace fiona::host
