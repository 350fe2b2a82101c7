// fiona-contract LIBRARY COMPONENT [BROUGHT …]: opens what the library needs beside it, puts a component on a bench,
// and holds each of its ports to what its service promises. One line a port: "PORT<tab>ok|wrong|note<tab>TEXT". Exit
// code 0, whatever the lines say.
#include <google/protobuf/descriptor.h>
#include <google/protobuf/reflection.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <iostream>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <string>
#include <vector>

#include "fiona/options.pb.h"
#include "fiona/testing/bench.hpp"
#include "fiona/tool.hpp"
#include "open_plugin.hpp"

namespace {

using namespace std::chrono_literals;
using fiona::Object;
using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;

constexpr fiona::Duration kStep = 10ms;
constexpr fiona::Duration kShortest = 3s;
constexpr fiona::Duration kLongest = 60s;
constexpr int kPeriods = 20;
constexpr double kTolerance = 0.1;  // of a period
constexpr int kDeepest = 6;

/// The side of a square matrix of so many elements; 0: it is none.
int side_of(int elements) {
  const int side = static_cast<int>(std::lround(std::sqrt(elements)));
  return side * side == elements ? side : 0;
}

/// A number that the field's rules allow, in the middle of its range where it has both ends.
double allowed_number(const FieldDescriptor& field) {
  const auto& options = field.options();
  const bool low = options.HasExtension(fiona::min);
  const bool high = options.HasExtension(fiona::max);
  const double min = options.GetExtension(fiona::min);
  const double max = options.GetExtension(fiona::max);
  if (low && high) return std::midpoint(min, max);
  return low ? std::max(0.0, min) : high ? std::min(0.0, max) : 0;
}

void set_number(Object& object, const FieldDescriptor& field, double number, bool add) {
  const auto& reflect = *object.GetReflection();
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return add ? reflect.AddDouble(&object, &field, number) : reflect.SetDouble(&object, &field, number);
    case FieldDescriptor::CPPTYPE_FLOAT: {
      const auto value = static_cast<float>(number);
      return add ? reflect.AddFloat(&object, &field, value) : reflect.SetFloat(&object, &field, value);
    }
    case FieldDescriptor::CPPTYPE_INT32: {
      const auto value = static_cast<std::int32_t>(number);
      return add ? reflect.AddInt32(&object, &field, value) : reflect.SetInt32(&object, &field, value);
    }
    case FieldDescriptor::CPPTYPE_UINT32: {
      const auto value = static_cast<std::uint32_t>(number);
      return add ? reflect.AddUInt32(&object, &field, value) : reflect.SetUInt32(&object, &field, value);
    }
    case FieldDescriptor::CPPTYPE_INT64: {
      const auto value = static_cast<std::int64_t>(number);
      return add ? reflect.AddInt64(&object, &field, value) : reflect.SetInt64(&object, &field, value);
    }
    case FieldDescriptor::CPPTYPE_UINT64: {
      const auto value = static_cast<std::uint64_t>(number);
      return add ? reflect.AddUInt64(&object, &field, value) : reflect.SetUInt64(&object, &field, value);
    }
    case FieldDescriptor::CPPTYPE_BOOL:
      return add ? reflect.AddBool(&object, &field, true) : reflect.SetBool(&object, &field, true);
    default: return;
  }
}

double number_in(const Object& object, const FieldDescriptor& field) {
  const auto& reflect = *object.GetReflection();
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE: return reflect.GetDouble(object, &field);
    case FieldDescriptor::CPPTYPE_FLOAT: return reflect.GetFloat(object, &field);
    case FieldDescriptor::CPPTYPE_INT32: return reflect.GetInt32(object, &field);
    case FieldDescriptor::CPPTYPE_UINT32: return reflect.GetUInt32(object, &field);
    case FieldDescriptor::CPPTYPE_INT64: return static_cast<double>(reflect.GetInt64(object, &field));
    case FieldDescriptor::CPPTYPE_UINT64: return static_cast<double>(reflect.GetUInt64(object, &field));
    default: return 0;
  }
}

/// An object that breaks no rule of its fields: flags are set, numbers are in the middle of their range, covariances
/// are unit matrices.
void fill(Object& object, int depth = 0) {
  const Descriptor& type = *object.GetDescriptor();
  const auto& reflect = *object.GetReflection();
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    const int size = static_cast<int>(field.options().GetExtension(fiona::size));
    if (field.is_repeated()) {
      const int side = field.options().GetExtension(fiona::covariance) ? side_of(size) : 0;
      for (int k = 0; k < size; ++k)
        set_number(object, field, side > 0 ? (k % (side + 1) == 0 ? 1 : 0) : allowed_number(field), true);
    } else if (field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      if (depth < kDeepest) fill(*reflect.MutableMessage(&object, &field), depth + 1);
    } else {
      set_number(object, field, allowed_number(field), false);
    }
  }
}

std::shared_ptr<Object> made(const Descriptor& type) {
  const auto* prototype = google::protobuf::MessageFactory::generated_factory()->GetPrototype(&type);
  std::shared_ptr<Object> object(prototype->New());
  fill(*object);
  return object;
}

std::string seconds(fiona::Duration time) {
  const double value = fiona::to_seconds(time);
  char text[40];
  std::snprintf(text, sizeof text, value < 1 ? "%.0f ms" : "%.2f s", value < 1 ? value * 1000 : value);
  return text;
}

class ContractBench {
 public:
  ContractBench(const fiona::Plugin::Entry& entry) : bench_(entry.make, entry.name) {}

  void run() {
    if (!starts()) return;
    feed();
    for (const fiona::Port* port : bench_.hull().ports()) {
      const bool pushes = port->direction() == fiona::PortDirection::Provides && port->service().is_push();
      if (pushes) check_push(*port);
      if (has_failed()) return;
    }
    for (const fiona::Port* port : bench_.hull().ports()) {
      if (port->direction() == fiona::PortDirection::Provides && !port->service().is_push()) check_asked(*port);
      if (has_failed()) return;
    }
    check_parameters();
    has_failed();
  }

 private:
  struct Heard {
    std::vector<fiona::TimePoint> times{};
    std::optional<std::string> silence{};
  };

  static void tell(const std::string& what, const std::string& state, std::string text) {
    for (char& letter : text) letter = letter == '\n' || letter == '\t' ? ' ' : letter;
    std::cout << what << '\t' << state << '\t' << text << std::endl;
  }

  bool starts() {
    const auto modes = bench_.hull().main_modes();
    const std::string mode = modes.empty() ? std::string(fiona::kModeActive) : modes.front();
    for (const fiona::Port* port : bench_.hull().ports()) {
      const auto* answer = port->service().answer();
      if (port->direction() == fiona::PortDirection::Requires && port->service().pattern() == fiona::QUERY)
        bench_.answer_any_with(port->name(), [answer](const Object&) { return made(*answer); });
    }
    try {
      bench_.start(mode);
      tell("start", "ok", "reaches " + mode);
      return true;
    } catch (const fiona::Error& error) {
      tell("start", "wrong", "does not reach " + mode + ": " + error.what());
      return false;
    }
  }

  bool has_failed() {
    if (bench_.mode() != "failed") return false;
    tell("life", "wrong", "it has failed: " + bench_.reason());
    return true;
  }

  static fiona::Duration period_of(const fiona::Port& port) {
    const fiona::Duration period = port.service().period();
    return period > fiona::Duration::zero() ? period : fiona::Duration(200ms);
  }

  /// Lets time pass, gives required ports what they wait for, and notes when the provided ones speak.
  void feed() {
    fiona::Duration whole = kShortest;
    for (const fiona::Port* port : bench_.hull().ports())
      whole = std::clamp(kPeriods * period_of(*port), whole, kLongest);
    std::map<const fiona::Port*, fiona::TimePoint> due;
    const fiona::TimePoint end = bench_.now() + whole;
    while (bench_.now() < end && bench_.mode() != "failed") {
      for (const fiona::Port* port : bench_.hull().ports()) {
        const bool in = port->direction() == fiona::PortDirection::Requires && port->service().is_push();
        const auto known = due.try_emplace(port, bench_.now()).first;
        if (!in || known->second > bench_.now()) continue;
        known->second += period_of(*port);
        bench_.put_any(port->name(), made(port->service().object()));
      }
      bench_.advance(kStep);
      listen();
    }
    fed_ = whole;
  }

  void listen() {
    for (const fiona::Port* port : bench_.hull().ports()) {
      if (port->direction() != fiona::PortDirection::Provides || !port->service().is_push()) continue;
      Heard& heard = heard_[port];
      for ([[maybe_unused]] const auto& envelope : bench_.take_any(port->name())) heard.times.push_back(bench_.now());
      if (auto silence = bench_.take_silence(port->name()); silence && !heard.silence) heard.silence = silence;
    }
  }

  void check_push(const fiona::Port& port) {
    const Heard& heard = heard_[&port];
    const auto& counters = bench_.hull().find_port(port.name())->counters();
    if (const auto refusal = counters.last_refusal()) {
      const auto count = std::to_string(counters.refused.load());
      return tell(port.name(), "wrong", count + " objects break a rule: " + refusal->reason);
    }
    if (heard.times.empty()) return check_silence(port, heard);
    const fiona::Duration period = port.service().period();
    const std::string often = std::to_string(heard.times.size()) + " objects in " + seconds(fed_);
    if (port.service().pattern() == fiona::PUSH_TIMED && heard.times.size() > 1 && declared_period(port)) {
      const auto mean = (heard.times.back() - heard.times.front()) / static_cast<int>(heard.times.size() - 1);
      const fiona::Duration expected = *declared_period(port);
      if (std::abs(fiona::to_seconds(mean - expected)) > kTolerance * fiona::to_seconds(expected))
        return tell(port.name(), "wrong", "every " + seconds(mean) + ", and its cycle is " + seconds(expected));
      return tell(port.name(), "ok", often + ", every " + seconds(mean));
    }
    if (heard.silence) return tell(port.name(), "wrong", often + "; in between: " + *heard.silence);
    tell(port.name(), "ok", often + (period > fiona::Duration::zero() ? ", usual cycle " + seconds(period) : ""));
  }

  /// Of a push timed whose hull calls a function: the cycle of that, which may be another than the service's.
  std::optional<fiona::Duration> declared_period(const fiona::Port& port) {
    for (const fiona::Task* task : bench_.hull().tasks()) {
      if (task->name() == port.name() && task->when().kind() == fiona::When::Kind::Periodic)
        return task->when().period();
    }
    return port.service().period() > fiona::Duration::zero() ? std::optional(port.service().period()) : std::nullopt;
  }

  void check_silence(const fiona::Port& port, const Heard& heard) {
    const std::string said = "says nothing in " + seconds(fed_);
    const bool may_wait = requires_something();
    if (port.service().pattern() == fiona::PUSH_TIMED && !may_wait)
      return tell(port.name(), "wrong", said + "; the service has a cycle");
    if (heard.silence && !may_wait) return tell(port.name(), "wrong", said + ": " + *heard.silence);
    tell(port.name(), "note",
         said + (may_wait ? "; what it was given gave it no cause" : "; it speaks only on change"));
  }

  bool requires_something() {
    return std::ranges::any_of(bench_.hull().ports(), [](const fiona::Port* port) {
      return port->direction() == fiona::PortDirection::Requires;
    });
  }

  /// A query, an activation or an object that is sent.
  void check_asked(const fiona::Port& port) {
    const auto& service = port.service();
    if (service.pattern() == fiona::SEND) {
      const fiona::Outcome outcome = bench_.put_any(port.name(), made(service.object()));
      return tell(port.name(), outcome == fiona::Outcome::Ok ? "ok" : "wrong", "sent: " + text_of(outcome));
    }
    const auto asked = bench_.now();
    const auto answer = bench_.ask_any(port.name(), made(service.object()));
    const std::string what = service.pattern() == fiona::EVENT ? "activation: " : "request: ";
    constexpr std::string_view kBroken = "the answer was refused: ";
    if (answer.reason().starts_with(kBroken)) {
      return tell(port.name(), "wrong", "answer: " + answer.reason().substr(kBroken.size()));
    }
    const bool refused =
        answer.outcome() == fiona::Outcome::Rejected && answer.reason() != "no answer" && bench_.mode() != "failed";
    const std::string reason = answer.reason().empty() ? "" : ", " + answer.reason();
    const bool ok = answer || refused;
    tell(port.name(), ok ? "ok" : "wrong",
         what + text_of(answer.outcome()) + reason + (ok ? "" : " after " + seconds(bench_.now() - asked)));
  }

  static std::string text_of(fiona::Outcome outcome) { return std::string(to_string(outcome)); }

  /// What is beyond a range is refused, and changes nothing; its ends are taken, or refused, and lived with.
  void check_parameters() {
    if (!bench_.hull().parameters()) return;
    const Descriptor& type = *bench_.hull().parameters()->snapshot()->GetDescriptor();
    int ends = 0;
    for (int i = 0; i < type.field_count(); ++i) {
      for (const bool upper : {false, true}) {
        const FieldDescriptor& field = *type.field(i);
        if (field.is_repeated() || !field.options().HasExtension(upper ? fiona::max : fiona::min)) continue;
        ++ends;
        if (const std::string fault = fault_at_end(field, upper); !fault.empty())
          return tell("parameters", "wrong", fault);
      }
    }
    if (ends > 0)
      tell("parameters", "ok", std::to_string(ends) + " ends of ranges: beyond them is refused, at them it lives");
  }

  std::string fault_at_end(const FieldDescriptor& field, bool upper) {
    const bool real =
        field.cpp_type() == FieldDescriptor::CPPTYPE_DOUBLE || field.cpp_type() == FieldDescriptor::CPPTYPE_FLOAT;
    const double end = field.options().GetExtension(upper ? fiona::max : fiona::min);
    const double beyond = end + (upper ? 1 : -1) * (real ? std::max(1.0, std::abs(end)) * 0.01 : 1.0);
    const auto before = bench_.hull().parameters()->snapshot();
    if (takes(field, beyond)) return field.name() + " takes what is beyond its range";
    if (bench_.hull().parameters()->snapshot()->SerializeAsString() != before->SerializeAsString())
      return field.name() + " is changed by what was refused";
    if (!takes(field, end)) return "";
    bench_.advance(1s);
    if (bench_.mode() == "failed")
      return field.name() + " may be " + number_text(end) + ", and then it fails: " + bench_.reason();
    takes(field, number_in(*before, field));
    return "";
  }

  static std::string number_text(double number) {
    char text[40];
    std::snprintf(text, sizeof text, "%g", number);
    return text;
  }

  bool takes(const FieldDescriptor& field, double value) {
    fiona::control::Argument argument;
    argument.set_name(field.name());
    const bool whole = value == std::floor(value) && std::abs(value) < 9e15;
    if (whole)
      argument.mutable_value()->set_integer(static_cast<std::int64_t>(value));
    else
      argument.mutable_value()->set_number(value);
    try {
      bench_.hull().set_parameters({&argument, 1}, fiona::kDefaultDeadline);
      return true;
    } catch (const fiona::Error&) {
      return false;
    }
  }

  fiona::testing::AnyBench bench_;
  std::map<const fiona::Port*, Heard> heard_;
  fiona::Duration fed_{};
};

void test(const std::string& library, const std::string& component, const std::vector<std::string>& brought) {
  const fiona::Plugin plugin = fiona::tools::open_plugin(library, brought);
  for (const auto& entry : plugin.entries()) {
    if (entry.name == component) return ContractBench(entry).run();
  }
  std::string known;
  for (const auto& entry : plugin.entries()) known += (known.empty() ? "" : ", ") + entry.name;
  throw fiona::Error(fiona::ErrorCode::NotFound,
                     {.what = "the plugin has no component '" + component + "'", .expected = "one of " + known});
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    std::cerr << "usage: fiona-contract LIBRARY COMPONENT [BROUGHT …]\n";
    return static_cast<int>(fiona::ErrorCode::Usage);
  }
  return fiona::run_tool([&] {
    test(argv[1], argv[2], {argv + 3, argv + argc});
    return 0;
  });
}
