#include "fiona/contract.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <set>
#include <vector>

#include "fiona/options.pb.h"

namespace fiona {

using google::protobuf::Descriptor;
using google::protobuf::EnumDescriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::ServiceDescriptor;

namespace {

using Difference = std::optional<std::string>;

/// Compares two message types once, nested and recursive ones included.
class Comparison {
 public:
  Difference messages(const Descriptor& a, const Descriptor& b) {
    if (&a == &b || !seen_.insert({&a, &b}).second) return {};
    if (a.full_name() != b.full_name()) return fmt::format("object {} is not {}", a.full_name(), b.full_name());
    std::set<int> numbers;
    for (int i = 0; i < a.field_count(); ++i) numbers.insert(a.field(i)->number());
    for (int i = 0; i < b.field_count(); ++i) numbers.insert(b.field(i)->number());
    for (const int number : numbers) {
      const FieldDescriptor* x = a.FindFieldByNumber(number);
      const FieldDescriptor* y = b.FindFieldByNumber(number);
      // A field that one side lacks is how a minor version grows: protobuf keeps it apart.
      if (!x || !y) continue;
      if (auto difference = fields(*x, *y)) return difference;
    }
    return {};
  }

 private:
  static Difference differs(const FieldDescriptor& field, std::string_view what, std::string_view a,
                            std::string_view b) {
    return fmt::format("field {} has {} '{}' required, '{}' provided", field.full_name(), what, a, b);
  }

  Difference fields(const FieldDescriptor& a, const FieldDescriptor& b) {
    if (a.name() != b.name()) return differs(a, "name", a.name(), b.name());
    if (a.type() != b.type()) return differs(a, "type", a.type_name(), b.type_name());
    const auto cardinality = [](const FieldDescriptor& f) {
      return f.is_repeated() ? "repeated" : f.has_presence() ? "optional" : "singular";
    };
    if (cardinality(a) != std::string_view(cardinality(b))) {
      return differs(a, "cardinality", cardinality(a), cardinality(b));
    }
    const auto& x = a.options();
    const auto& y = b.options();
    if (x.GetExtension(unit) != y.GetExtension(unit)) {
      return differs(a, "unit", x.GetExtension(unit), y.GetExtension(unit));
    }
    if (x.GetExtension(frame) != y.GetExtension(frame)) {
      return differs(a, "frame", x.GetExtension(frame), y.GetExtension(frame));
    }
    if (x.GetExtension(size) != y.GetExtension(size)) {
      return differs(a, "size", std::to_string(x.GetExtension(size)), std::to_string(y.GetExtension(size)));
    }
    if (a.type() == FieldDescriptor::TYPE_ENUM) return enums(a, *a.enum_type(), *b.enum_type());
    if (a.type() == FieldDescriptor::TYPE_MESSAGE) return messages(*a.message_type(), *b.message_type());
    return {};
  }

  static Difference enums(const FieldDescriptor& field, const EnumDescriptor& a, const EnumDescriptor& b) {
    for (int i = 0; i < a.value_count(); ++i) {
      const auto* other = b.FindValueByName(a.value(i)->name());
      if (other && other->number() != a.value(i)->number()) {
        return differs(field, "enumerator " + a.value(i)->name(), std::to_string(a.value(i)->number()),
                       std::to_string(other->number()));
      }
    }
    return {};
  }

  std::set<std::pair<const Descriptor*, const Descriptor*>> seen_;
};

std::uint32_t major_of(const ServiceContract& contract) { return contract.major() == 0 ? 1 : contract.major(); }

}  // namespace

Difference contract_difference(const ServiceDescriptor& required, const ServiceDescriptor& provided) {
  if (&required == &provided) return {};
  if (required.full_name() != provided.full_name()) {
    return fmt::format("service {} is not {}", required.full_name(), provided.full_name());
  }
  const auto& client = required.options().GetExtension(contract);
  const auto& server = provided.options().GetExtension(contract);
  if (client.pattern() != server.pattern()) return "the pattern differs";
  if (major_of(client) != major_of(server) || server.minor() < client.minor()) {
    return fmt::format("version {}.{} required, {}.{} provided", major_of(client), client.minor(), major_of(server),
                       server.minor());
  }
  if (required.method_count() != provided.method_count()) return "the number of methods differs";
  Comparison comparison;
  for (int i = 0; i < required.method_count(); ++i) {
    const auto& a = *required.method(i);
    const auto& b = *provided.method(i);
    if (auto difference = comparison.messages(*a.input_type(), *b.input_type())) return difference;
    if (auto difference = comparison.messages(*a.output_type(), *b.output_type())) return difference;
  }
  return {};
}

Difference object_difference(const Descriptor& required, const Descriptor& provided) {
  return Comparison().messages(required, provided);
}

}  // namespace fiona
