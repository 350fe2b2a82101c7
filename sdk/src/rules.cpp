#include "fiona/rules.hpp"

#include <fmt/format.h>
#include <google/protobuf/descriptor.h>
#include <google/protobuf/reflection.h>

#include <algorithm>
#include <cmath>

#include "fiona/secrets.hpp"

namespace fiona {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Reflection;

namespace {

using Number = double (*)(const Reflection&, const Object&, const FieldDescriptor&);

template <class T, T (Reflection::*get)(const Object&, const FieldDescriptor*) const>
double number(const Reflection& reflect, const Object& object, const FieldDescriptor& field) {
  return static_cast<double>((reflect.*get)(object, &field));
}

/// How the field's number is asked for; null where it has none.
Number number_of(const FieldDescriptor& field) {
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE: return number<double, &Reflection::GetDouble>;
    case FieldDescriptor::CPPTYPE_FLOAT: return number<float, &Reflection::GetFloat>;
    case FieldDescriptor::CPPTYPE_INT32: return number<google::protobuf::int32, &Reflection::GetInt32>;
    case FieldDescriptor::CPPTYPE_UINT32: return number<google::protobuf::uint32, &Reflection::GetUInt32>;
    case FieldDescriptor::CPPTYPE_INT64: return number<google::protobuf::int64, &Reflection::GetInt64>;
    case FieldDescriptor::CPPTYPE_UINT64: return number<google::protobuf::uint64, &Reflection::GetUInt64>;
    default: return nullptr;
  }
}

/// Calls `take` with the type of the field's numbers; nothing happens where it has none.
template <class F>
void with_number_type(const FieldDescriptor& field, F take) {
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE: return take(double());
    case FieldDescriptor::CPPTYPE_FLOAT: return take(float());
    case FieldDescriptor::CPPTYPE_INT32: return take(google::protobuf::int32());
    case FieldDescriptor::CPPTYPE_UINT32: return take(google::protobuf::uint32());
    case FieldDescriptor::CPPTYPE_INT64: return take(google::protobuf::int64());
    case FieldDescriptor::CPPTYPE_UINT64: return take(google::protobuf::uint64());
    default: return;
  }
}

std::optional<std::size_t> length_of(const Object& object, const Reflection& reflect, const FieldDescriptor& field) {
  if (field.is_repeated()) return static_cast<std::size_t>(reflect.FieldSize(object, &field));
  if (field.cpp_type() != FieldDescriptor::CPPTYPE_STRING) return std::nullopt;
  std::string scratch;
  return reflect.GetStringReference(object, &field, &scratch).size();
}

std::string unit_of(const FieldDescriptor& field) {
  const std::string& unit = field.options().GetExtension(fiona::unit);
  return unit.empty() ? "" : " " + unit;
}

bool is_floating(const FieldDescriptor& field) {
  return field.cpp_type() == FieldDescriptor::CPPTYPE_DOUBLE || field.cpp_type() == FieldDescriptor::CPPTYPE_FLOAT;
}

bool is_enumeration(const FieldDescriptor& field) { return field.cpp_type() == FieldDescriptor::CPPTYPE_ENUM; }

/// Wires join only types with the same enumerators, so that no other number is one of another version.
std::optional<std::string> no_enumerator(const Object& object, const Reflection& reflect,
                                         const FieldDescriptor& field) {
  const int count = field.is_repeated() ? reflect.FieldSize(object, &field) : 1;
  for (int i = 0; i < count; ++i) {
    const int number =
        field.is_repeated() ? reflect.GetRepeatedEnumValue(object, &field, i) : reflect.GetEnumValue(object, &field);
    if (field.enum_type()->FindValueByNumber(number)) continue;
    return fmt::format("{}{} is {}, no enumerator of {}", field.name(),
                       field.is_repeated() ? fmt::format("[{}]", i) : "", number, field.enum_type()->name());
  }
  return std::nullopt;
}

/// Whether a row-major matrix is one of covariances, as far as rounding tells: by elimination with the largest diagonal
/// element first (Higham, Accuracy and Stability of Numerical Algorithms, 10.3).
bool is_covariance(std::vector<double> matrix) {
  const auto side = static_cast<std::size_t>(std::lround(std::sqrt(static_cast<double>(matrix.size()))));
  if (side * side != matrix.size()) return false;
  double scale = 0;
  for (const double element : matrix) scale = std::max(scale, std::abs(element));
  if (scale == 0) return true;
  for (double& element : matrix) element /= scale;
  constexpr double kSmall = 1e-9;
  const auto at = [&](std::size_t row, std::size_t column) -> double& { return matrix[row * side + column]; };
  std::vector<std::size_t> left;
  for (std::size_t i = 0; i < side; ++i) {
    for (const std::size_t j : left) {
      if (std::abs(at(i, j) - at(j, i)) > kSmall) return false;
    }
    left.push_back(i);
  }
  while (!left.empty()) {
    const auto largest =
        std::max_element(left.begin(), left.end(), [&](auto a, auto b) { return at(a, a) < at(b, b); });
    const std::size_t pivot = *largest;
    const double diagonal = at(pivot, pivot);
    left.erase(largest);
    if (diagonal < -kSmall) return false;
    for (const std::size_t i : left) {
      if (diagonal <= kSmall && std::abs(at(i, pivot)) > kSmall) return false;
      for (const std::size_t j : left) at(i, j) -= diagonal > kSmall ? at(i, pivot) * at(pivot, j) / diagonal : 0;
    }
  }
  return true;
}

}  // namespace

ObjectRules::ObjectRules(const Descriptor& type) : root_(compile(type)) {}

const ObjectRules::Rules& ObjectRules::compile(const Descriptor& type) {
  const auto [entry, is_new] = rules_.try_emplace(&type);
  Rules& rules = entry->second;  // stays where it is
  if (!is_new) return rules;
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    const auto& options = field.options();
    FieldRule rule{.field = &field,
                   .number = field.is_repeated() ? nullptr : number_of(field),
                   .repeated = field.is_repeated(),
                   .presence = field.has_presence(),
                   .enumeration = is_enumeration(field)};
    if (options.HasExtension(fiona::min)) rule.min = options.GetExtension(fiona::min);
    if (options.HasExtension(fiona::max)) rule.max = options.GetExtension(fiona::max);
    rule.size = static_cast<int>(options.GetExtension(fiona::size));
    rule.max_size = options.GetExtension(fiona::max_size);
    rule.finite = is_floating(field) && !options.GetExtension(fiona::allow_not_finite);
    rule.covariance = field.is_repeated() && field.cpp_type() == FieldDescriptor::CPPTYPE_DOUBLE &&
                      options.GetExtension(fiona::covariance);
    if (field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) rule.nested = &compile(*field.message_type());
    if (rule.min || rule.max || rule.size > 0 || rule.max_size > 0 || rule.finite || rule.covariance || rule.nested ||
        rule.enumeration)
      rules.push_back(rule);
  }
  return rules;
}

std::optional<std::string> ObjectRules::first_violation(const Object& object) const { return check(object, root_); }

std::optional<std::string> ObjectRules::check(const Object& object, const Rules& rules) const {
  if (rules.empty()) return std::nullopt;
  const Reflection& reflect = *object.GetReflection();  // asked for once: it costs as much as a field
  for (const FieldRule& rule : rules) {
    if (auto violation = rule.nested ? check_nested(object, reflect, rule) : check_field(object, reflect, rule))
      return violation;
  }
  return std::nullopt;
}

bool ObjectRules::FieldRule::allows(double value) const {
  return (!finite || std::isfinite(value)) && !(min && value < *min) && !(max && value > *max);
}

std::string ObjectRules::FieldRule::violation(double value, const std::string& name) const {
  if (is_secret(*field)) return fmt::format("{} is not as its rule says", name);
  if (finite && !std::isfinite(value)) return fmt::format("{} is {}, not a finite number", name, value);
  const bool below = min && value < *min;
  return fmt::format("{} is {}, {} {}{}", name, value, below ? "below" : "above", below ? *min : *max, unit_of(*field));
}

std::optional<std::string> ObjectRules::check_field(const Object& object, const Reflection& reflect,
                                                    const FieldRule& rule) const {
  const FieldDescriptor& field = *rule.field;
  if (rule.presence && !reflect.HasField(object, &field)) return std::nullopt;
  if (rule.size > 0 || rule.max_size > 0) {
    const auto length = length_of(object, reflect, field);
    const std::string_view things = field.is_repeated() ? "elements" : "bytes";
    if (length && rule.size > 0 && *length != 0 && *length != static_cast<std::size_t>(rule.size)) {
      return fmt::format("{} has {} {}, not {}", field.name(), *length, things, rule.size);
    }
    if (length && rule.max_size > 0 && *length > rule.max_size) {
      return fmt::format("{} has {} {}, more than {}", field.name(), *length, things, rule.max_size);
    }
  }
  if (rule.enumeration) return no_enumerator(object, reflect, field);
  if (!rule.min && !rule.max && !rule.finite && !rule.covariance) return std::nullopt;
  std::optional<std::string> violation;
  if (rule.number) {
    const double value = rule.number(reflect, object, field);
    if (!rule.allows(value)) violation = rule.violation(value, field.name());
    return violation;
  }
  with_number_type(field, [&](auto type) {
    int index = 0;
    for (const auto element : reflect.GetRepeatedFieldRef<decltype(type)>(object, &field)) {
      const auto value = static_cast<double>(element);
      if (!rule.allows(value)) {
        violation = rule.violation(value, fmt::format("{}[{}]", field.name(), index));
        return;
      }
      ++index;
    }
  });
  if (violation || !rule.covariance) return violation;
  const auto elements = reflect.GetRepeatedFieldRef<double>(object, &field);
  if (is_covariance({elements.begin(), elements.end()})) return std::nullopt;
  return fmt::format("{} is no covariance: not symmetric and positive semi-definite", field.name());
}

std::optional<std::string> ObjectRules::check_nested(const Object& object, const Reflection& reflect,
                                                     const FieldRule& rule) const {
  const FieldDescriptor& field = *rule.field;
  const auto prefixed = [&](std::optional<std::string> violation, const std::string& prefix) {
    if (violation) violation = prefix + "." + *violation;
    return violation;
  };
  if (!rule.repeated) {
    if (!reflect.HasField(object, &field)) return std::nullopt;
    return prefixed(check(reflect.GetMessage(object, &field), *rule.nested), field.name());
  }
  const int count = reflect.FieldSize(object, &field);
  if (rule.size > 0 && count != 0 && count != rule.size) {
    return fmt::format("{} has {} elements, not {}", field.name(), count, rule.size);
  }
  if (rule.max_size > 0 && static_cast<std::size_t>(count) > rule.max_size) {
    return fmt::format("{} has {} elements, more than {}", field.name(), count, rule.max_size);
  }
  for (int i = 0; i < count; ++i) {
    auto violation = check(reflect.GetRepeatedMessage(object, &field, i), *rule.nested);
    if (violation) return prefixed(std::move(violation), fmt::format("{}[{}]", field.name(), i));
  }
  return std::nullopt;
}

}  // namespace fiona
