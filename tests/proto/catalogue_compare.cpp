#include <algorithm>
#include <cctype>
#include <optional>
#include <regex>

#include "catalogue.hpp"
#include "fiona/options.pb.h"

namespace fiona::catalogue {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::DescriptorPool;
using google::protobuf::FieldDescriptor;
using google::protobuf::FileDescriptor;
using google::protobuf::MethodDescriptor;
using google::protobuf::ServiceDescriptor;

using Differences = std::vector<std::string>;

// What the document's data type becomes in a proto.
struct ProtoType {
  std::string spelling;  // as proto_spelling() writes it
  bool same = true;      // proto's type says all of it, so no (fiona.document_type)
  std::optional<std::pair<double, double>> range{};
  std::uint32_t size = 0;
};

const std::map<std::string, ProtoType>& scalar_types() {
  static const std::map<std::string, ProtoType> types = {
      {"boolean", {"bool"}},
      {"double", {"double"}},
      {"float", {"float"}},
      {"string", {"string"}},
      {"int8", {"int32", false, {{-128, 127}}}},
      {"int16", {"int32", false, {{-32768, 32767}}}},
      {"int32", {"int32"}},
      {"int64", {"int64"}},
      {"uint8", {"uint32", false, {{0, 255}}}},
      {"uint16", {"uint32", false, {{0, 65535}}}},
      {"uint32", {"uint32"}},
      {"uint64", {"uint64"}},
      {"enum", {"enum", false}},
  };
  return types;
}

// The document's unit as the symbol that (fiona.unit) has; a unit that is not here is not known.
const std::map<std::string, std::string>& unit_symbols() {
  static const std::map<std::string, std::string> symbols = {
      {"", ""},          {"--", ""},        {"Dps (degrees per second)", "deg/s"},
      {"Dps", "deg/s"},  {"g", "g"},        {"Gauss", "gauss"},
      {"dBm", "dBm"},    {"ms", "ms"},      {"s", "s"},
      {"degree", "deg"}, {"Degree", "deg"}, {"Decimal degrees", "deg"},
      {"meter", "m"},    {"M", "m"},        {"m", "m"},
      {"mm", "mm"},      {"rad", "rad"},    {"levels", "level"},
      {"Hz", "Hz"},
  };
  return symbols;
}

const std::map<std::string, fiona::Pattern>& patterns() {
  static const std::map<std::string, fiona::Pattern> names = {
      {"Send", fiona::SEND},
      {"Query", fiona::QUERY},
      {"Push Newest", fiona::PUSH_NEWEST},
      {"Push newest", fiona::PUSH_NEWEST},
      {"Push Timed", fiona::PUSH_TIMED},
      {"Event", fiona::EVENT},
  };
  return names;
}

std::string quoted(const std::string& text) { return '"' + text + '"'; }

std::string document_name(const FieldDescriptor& field) {
  const std::string& name = field.options().GetExtension(fiona::document);
  return name.empty() ? field.name() : name;
}

std::string document_name(const ServiceDescriptor& service) {
  const std::string& name = service.options().GetExtension(fiona::document_service);
  return name.empty() ? service.name() : name;
}

std::string proto_spelling(const FieldDescriptor& field) {
  const std::string base =
      field.type() == FieldDescriptor::TYPE_MESSAGE ? field.message_type()->name() : field.type_name();
  return (field.is_repeated() ? "repeated " : "") + base;
}

std::optional<ProtoType> scalar_or_object(std::string type) {
  std::smatch match;
  if (std::regex_match(type, match, std::regex(R"(CommObjectRef\((\w+)\))"))) return ProtoType{match[1]};
  if (type.rfind("Comm", 0) == 0) return ProtoType{type};
  std::transform(type.begin(), type.end(), type.begin(), [](unsigned char c) { return std::tolower(c); });
  const auto found = scalar_types().find(type);
  return found == scalar_types().end() ? std::nullopt : std::optional(found->second);
}

// Nothing for a type that no rule covers: "List of Integers (2 x n)" needs a decision.
std::optional<ProtoType> map_type(const std::string& type) {
  std::smatch match;
  if (!std::regex_match(type, match, std::regex(R"((.+)\[(\d+|\*)\])"))) return scalar_or_object(type);
  std::optional<ProtoType> element = scalar_or_object(match[1]);
  if (!element) return std::nullopt;
  element->spelling = "repeated " + element->spelling;
  if (match[2] != "*") {
    element->size = static_cast<std::uint32_t>(std::stoul(match[2]));
    element->same = false;
  }
  return element;
}

class Comparison {
 public:
  Comparison(const std::vector<Row>& rows, const DescriptorPool& pool) : rows_(rows), pool_(pool) {}

  Differences run() {
    for (const Row& row : rows_) {
      if (const Descriptor* message = message_of(row)) compare_attribute(row, *message);
    }
    for (const auto& [name, rows] : rows_by_service()) compare_service(rows);
    for (const std::string& area : areas()) compare_file("fiona/" + area + ".proto");
    return std::move(differences_);
  }

 private:
  void differ(const Row& row, const std::string& text) {
    differences_.push_back("line " + std::to_string(row.line) + ": " + text);
  }

  // ---- the table against the protos

  const Descriptor* message_of(const Row& row) {
    const std::string name = "fiona." + row.area + "." + row.object;
    const Descriptor* message = pool_.FindMessageTypeByName(name);
    if (!message) differ(row, "message " + name + " does not exist");
    return message;
  }

  void compare_attribute(const Row& row, const Descriptor& message) {
    std::vector<const FieldDescriptor*> fields;
    std::string names;
    for (int i = 0; i < message.field_count(); ++i) {
      if (is_added(*message.field(i)) || document_name(*message.field(i)) != row.attribute) continue;
      fields.push_back(message.field(i));
      names += (names.empty() ? "" : "+") + message.field(i)->name();
    }
    const auto decided = row.decision.find("fields");
    if (fields.empty()) {
      differ(row, message.full_name() + " has no field for attribute " + quoted(row.attribute));
    } else if (decided == row.decision.end() ? fields.size() != 1 : decided->second != names) {
      differ(row, message.full_name() + " has the fields " + names + " for attribute " + quoted(row.attribute));
    }
    for (const FieldDescriptor* field : fields) compare_field(row, *field);
  }

  void compare_field(const Row& row, const FieldDescriptor& field) {
    compare_type(row, field);
    compare_unit(row, field);
    if (!row.decision.empty() && !has_comment(field)) {
      differ(row, field.full_name() + " has a decision in the table and no comment in the proto");
    }
  }

  void compare_type(const Row& row, const FieldDescriptor& field) {
    const auto decided = row.decision.find("type");
    const std::optional<ProtoType> expected =
        decided != row.decision.end() ? ProtoType{decided->second, false} : map_type(row.type);
    if (!expected) return differ(row, "type " + quoted(row.type) + " has no proto type and no decision");
    if (proto_spelling(field) != expected->spelling) {
      differ(row, field.full_name() + " is " + proto_spelling(field) + ", expected " + expected->spelling + " for " +
                      quoted(row.type));
    }
    const std::string& kept = field.options().GetExtension(fiona::document_type);
    if (kept != (expected->same ? "" : row.type)) {
      differ(row, field.full_name() + " keeps the document's type as " + quoted(kept) + ", expected " +
                      quoted(expected->same ? "" : row.type));
    }
    compare_bounds(row, field, *expected);
  }

  void compare_bounds(const Row& row, const FieldDescriptor& field, const ProtoType& expected) {
    const auto& options = field.options();
    if (options.GetExtension(fiona::size) != expected.size) {
      differ(row, field.full_name() + " has size " + std::to_string(options.GetExtension(fiona::size)) + ", expected " +
                      std::to_string(expected.size));
    }
    if (!expected.range) return;
    const bool ranged = options.HasExtension(fiona::min) && options.HasExtension(fiona::max) &&
                        options.GetExtension(fiona::min) >= expected.range->first &&
                        options.GetExtension(fiona::max) <= expected.range->second;
    if (!ranged) differ(row, field.full_name() + " does not carry the range of " + row.type);
  }

  void compare_unit(const Row& row, const FieldDescriptor& field) {
    const auto decided = row.decision.find("unit");
    const auto symbol = unit_symbols().find(row.unit);
    if (symbol == unit_symbols().end()) return differ(row, "unit " + quoted(row.unit) + " is not known");
    const bool is_decided = decided != row.decision.end();
    const std::string& expected = is_decided ? decided->second : symbol->second;
    if (is_decided && expected == symbol->second) differ(row, "the decision on the unit is not needed");
    const std::string& unit = field.options().GetExtension(fiona::unit);
    if (unit != expected) {
      differ(row, field.full_name() + " has unit " + quoted(unit) + ", expected " + quoted(expected));
    }
  }

  // ---- services

  std::map<std::string, std::vector<Row>> rows_by_service() const {
    std::map<std::string, std::vector<Row>> services;
    for (const Row& row : rows_) {
      if (!row.service.empty()) services[row.area + "/" + row.service].push_back(row);
    }
    return services;
  }

  const ServiceDescriptor* find_service(const Row& row) {
    const FileDescriptor* file = pool_.FindFileByName("fiona/" + row.area + ".proto");
    for (int i = 0; file && i < file->service_count(); ++i) {
      if (document_name(*file->service(i)) == row.service) return file->service(i);
    }
    return nullptr;
  }

  void compare_service(const std::vector<Row>& rows) {
    const Row& first = rows.front();
    const ServiceDescriptor* service = find_service(first);
    if (!service)
      return differ(first, "service " + quoted(first.service) + " is not in fiona/" + first.area + ".proto");
    const auto pattern = patterns().find(first.pattern);
    if (pattern == patterns().end()) return differ(first, "pattern " + quoted(first.pattern) + " is not known");
    const fiona::Pattern declared = service->options().GetExtension(fiona::contract).pattern();
    if (declared != pattern->second) {
      differ(first, service->full_name() + " has pattern " + fiona::Pattern_Name(declared) + ", expected " +
                        fiona::Pattern_Name(pattern->second));
    }
    compare_methods(first, *service, pattern->second, objects(rows));
  }

  static std::map<std::string, std::string> objects(const std::vector<Row>& rows) {
    std::map<std::string, std::string> by_role;
    for (const Row& row : rows) by_role[row.role] = "fiona." + row.area + "." + row.object;
    return by_role;
  }

  // The spelling of each pattern; an empty name is an object that the document does not give: one made of
  // added fields only.
  void compare_methods(const Row& row, const ServiceDescriptor& service, fiona::Pattern pattern,
                       std::map<std::string, std::string> object) {
    const std::string none = "fiona.None";
    if (pattern == fiona::SEND) {
      compare_method(row, service, "Object", object["object"], none);
    } else if (pattern == fiona::QUERY) {
      compare_method(row, service, "Query", object["request"], object["answer"]);
    } else if (pattern == fiona::EVENT) {
      compare_method(row, service, "Event", "", object["object"]);
      compare_method(row, service, "State", object["object"], none);
    } else {
      compare_method(row, service, "Object", none, object["object"]);
    }
    if (service.method_count() != (pattern == fiona::EVENT ? 2 : 1)) {
      differ(row, service.full_name() + " has " + std::to_string(service.method_count()) + " methods");
    }
  }

  void compare_method(const Row& row, const ServiceDescriptor& service, const std::string& name,
                      const std::string& input, const std::string& output) {
    const MethodDescriptor* method = service.FindMethodByName(name);
    if (!method) return differ(row, service.full_name() + " has no rpc " + name);
    compare_object(row, method->full_name() + " takes ", *method->input_type(), input);
    compare_object(row, method->full_name() + " returns ", *method->output_type(), output);
  }

  void compare_object(const Row& row, const std::string& what, const Descriptor& is, const std::string& expected) {
    if (expected.empty() && !all_added(is)) {
      differ(row, what + is.full_name() + ", which the document does not give and is not marked as added");
    } else if (!expected.empty() && is.full_name() != expected) {
      differ(row, what + is.full_name() + ", expected " + expected);
    }
  }

  // ---- the protos against the table

  void compare_file(const std::string& name) {
    const FileDescriptor* file = pool_.FindFileByName(name);
    if (!file) {
      differences_.push_back(name + " does not exist");
      return;
    }
    for (int i = 0; i < file->message_type_count(); ++i) find_rows(*file->message_type(i));
    for (int i = 0; i < file->service_count(); ++i) find_rows(*file->service(i));
  }

  void find_rows(const Descriptor& message) {
    for (int i = 0; i < message.field_count(); ++i) {
      const FieldDescriptor& field = *message.field(i);
      const bool listed = std::any_of(rows_.begin(), rows_.end(), [&](const Row& row) {
        return "fiona." + row.area + "." + row.object == message.full_name() && row.attribute == document_name(field);
      });
      if (listed == is_added(field)) {
        differences_.push_back(field.full_name() + (listed ? " is marked as added and has a row in the table"
                                                           : " has no row in the table and is not marked as added"));
      }
    }
  }

  void find_rows(const ServiceDescriptor& service) {
    const std::string name = document_name(service);
    const bool listed = std::any_of(rows_.begin(), rows_.end(), [&](const Row& row) {
      return row.service == name && "fiona/" + row.area + ".proto" == service.file()->name();
    });
    if (listed == (name == "added")) {
      differences_.push_back(service.full_name() + " has no row in the table and is not marked as added");
    }
  }

  const std::vector<Row>& rows_;
  const DescriptorPool& pool_;
  Differences differences_;
};

}  // namespace

Differences compare(const std::vector<Row>& rows, const DescriptorPool& pool) { return Comparison(rows, pool).run(); }

}  // namespace fiona::catalogue
