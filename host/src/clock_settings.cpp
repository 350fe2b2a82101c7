#include "clock_settings.hpp"

#include <fmt/format.h>

#include <optional>

#include "fiona/error.hpp"
#include "names.hpp"

namespace fiona::host {
namespace {

struct Asked {
  std::optional<bool> is_virtual;
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
    } else if (argument.name() == "speed" && number) {
      asked.speed =
          value.kind_case() == control::Value::kNumber ? value.number() : static_cast<double>(value.integer());
    } else {
      throw Error(ErrorCode::Usage,
                  {.what = "the host does not take '" + argument.name() + "' so",
                   .expected = "clock=system, clock=virtual, speed=TIMES-REAL-TIME (0: as fast as it goes), "
                               "deliveries=FILE",
                   .next = "get host"});
    }
  }
  return asked;
}

}  // namespace

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
  if (asked.deliveries && !asked.deliveries->empty() && !next.is_virtual) {
    throw Error(ErrorCode::Usage, {.what = "deliveries are recorded on a virtual clock",
                                   .next = "set host clock=virtual deliveries=FILE"});
  }
  if (next.is_virtual != is_virtual) {
    next.speed = 0;
    next.deliveries.clear();
  }
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
  value_of("speed").set_number(speed);
  if (before.deliveries != deliveries) value_of("deliveries").set_text(deliveries);
  return change;
}

}  // namespace fiona::host
