#include "clock_settings.hpp"

#include <fmt/format.h>
#include <google/protobuf/util/time_util.h>

#include <optional>

#include "fiona/error.hpp"
#include "names.hpp"

namespace fiona::host {
namespace {

using google::protobuf::util::TimeUtil;

/// 2040: an origin after 2043 is not believed (docs/wire-protocol.md, section 7).
constexpr std::int64_t kLatestStart_s = 2'208'988'800;

TimePoint start_of(const std::string& text) {
  google::protobuf::Timestamp time;
  const bool is_time = text == "0" || TimeUtil::FromString(text, &time);
  if (!is_time || time.seconds() < 0 || time.seconds() >= kLatestStart_s) {
    throw Error(ErrorCode::Usage, {.what = "a virtual clock does not start then",
                                   .expected = "0, or a time as in 2024-05-31T09:30:00.5Z, from 1970 to 2039",
                                   .found = text,
                                   .next = "set host clock=virtual start=2024-05-31T09:30:00Z"});
  }
  return TimePoint(Duration(TimeUtil::TimestampToNanoseconds(time)));
}

struct Asked {
  std::optional<bool> is_virtual;
  std::optional<TimePoint> start;
  std::optional<double> speed;
  std::optional<std::string> deliveries;
};

Asked asked_of(const control::Set& request) {
  Asked asked;
  for (const auto& argument : request.parameters()) {
    const auto& value = argument.value();
    const bool number = value.kind_case() == control::Value::kNumber || value.kind_case() == control::Value::kInteger;
    if (argument.name() == "clock" && (value.text() == "virtual" || value.text() == "system")) {
      asked.is_virtual = value.text() == "virtual";
    } else if (argument.name() == "deliveries" && value.kind_case() == control::Value::kText) {
      asked.deliveries = value.text();
    } else if (argument.name() == "start" && value.kind_case() == control::Value::kText) {
      asked.start = start_of(value.text());
    } else if (argument.name() == "start" && value.integer() == 0 && value.kind_case() == control::Value::kInteger) {
      asked.start = TimePoint{};
    } else if (argument.name() == "speed" && number) {
      asked.speed =
          value.kind_case() == control::Value::kNumber ? value.number() : static_cast<double>(value.integer());
    } else {
      throw Error(ErrorCode::Usage,
                  {.what = "the host does not take '" + argument.name() + "' so",
                   .expected = "clock=system, clock=virtual, speed=TIMES-REAL-TIME (0: as fast as it goes), "
                               "start=YYYY-MM-DDThh:mm:ssZ, deliveries=FILE",
                   .next = "get host"});
    }
  }
  return asked;
}

}  // namespace

std::string text_of_time(TimePoint time) {
  return TimeUtil::ToString(TimeUtil::NanosecondsToTimestamp(time.time_since_epoch().count()));
}

ClockSettings ClockSettings::changed(const control::Set& request) const {
  const Asked asked = asked_of(request);
  ClockSettings next = *this;
  next.is_virtual = asked.is_virtual.value_or(is_virtual);
  if (asked.speed && (*asked.speed < 0 || *asked.speed > 1e6)) {
    throw Error(
        ErrorCode::Usage,
        {.what = "the speed is out of range", .expected = "0 .. 1000000", .found = fmt::format("{}", *asked.speed)});
  }
  if (asked.speed && !next.is_virtual) {
    throw Error(ErrorCode::Usage, {.what = "the system clock has one speed", .next = "set host clock=virtual speed=…"});
  }
  if (asked.start && !next.is_virtual) {
    throw Error(ErrorCode::Usage, {.what = "the system clock starts when the host does",
                                   .next = "set host clock=virtual start=2024-05-31T09:30:00Z"});
  }
  if (asked.deliveries && !asked.deliveries->empty() && !next.is_virtual) {
    throw Error(ErrorCode::Usage, {.what = "deliveries are recorded on a virtual clock",
                                   .next = "set host clock=virtual deliveries=FILE"});
  }
  if (next.is_virtual != is_virtual) {
    next.start = {};
    next.speed = 0;
    next.deliveries.clear();
  }
  if (asked.start) next.start = *asked.start;
  if (asked.speed) next.speed = *asked.speed;
  if (asked.deliveries) next.deliveries = *asked.deliveries;
  return next;
}

control::Change ClockSettings::change_from(const ClockSettings& before) const {
  control::Change change;
  control::Set& request = *change.mutable_set();
  request.set_instance(std::string(kHostItself));
  const auto value_of = [&request](const char* name) -> control::Value& {
    auto& parameter = *request.add_parameters();
    parameter.set_name(name);
    return *parameter.mutable_value();
  };
  value_of("clock").set_text(is_virtual ? "virtual" : "system");
  if (!is_virtual) return change;
  value_of("start").set_text(text_of_time(start));
  value_of("speed").set_number(speed);
  if (before.deliveries != deliveries) value_of("deliveries").set_text(deliveries);
  return change;
}

}  // namespace fiona::host
