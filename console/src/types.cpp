#include "types.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <google/protobuf/util/json_util.h>
#include <fiona/error.hpp>
#include <fiona/secrets.hpp>

#include "fiona/options.pb.h"

namespace fiona::console {
namespace {

namespace pb = google::protobuf;

constexpr int kDeepest = 16;
/// Of one table of fields, and of one plugin's protos: types that have each other several times over grow without end.
constexpr std::size_t kMostRows = 1000;
constexpr int kMostFiles = 1000;

/// Adds a file after those that it needs; files that the set lacks come from the platform.
class PoolBuilder {
 public:
  PoolBuilder(const pb::FileDescriptorSet& files, pb::DescriptorPool& pool) : pool_(pool) {
    for (const auto& file : files.file()) given_[file.name()] = &file;
  }

  void add(const std::string& name) {
    if (!begun_.insert(name).second) return;
    pb::FileDescriptorProto copy;
    if (const auto found = given_.find(name); found != given_.end()) {
      copy = *found->second;
    } else if (const auto* own = pb::DescriptorPool::generated_pool()->FindFileByName(name)) {
      own->CopyTo(&copy);
    } else {
      refuse(name, "the file is missing");
    }
    for (const std::string& needed : copy.dependency()) add(needed);
    problems_.text.clear();
    if (pool_.BuildFileCollectingErrors(copy, &problems_) == nullptr) refuse(name, problems_.text);
  }

 private:
  struct Problems final : pb::DescriptorPool::ErrorCollector {
    void AddError(const std::string&, const std::string& element, const pb::Message*, ErrorLocation,
                  const std::string& message) override {
      if (text.empty()) text = element + ": " + message;
    }
    std::string text;
  };

  [[noreturn]] static void refuse(const std::string& name, const std::string& why) {
    throw Error(ErrorCode::Failed,
                ErrorText{.what = fmt::format("the descriptors do not fit together: {}", why),
                          .where = name,
                          .next = "run the console of the same version as the host: fiona --version"});
  }

  pb::DescriptorPool& pool_;
  Problems problems_;
  std::map<std::string, const pb::FileDescriptorProto*> given_;
  std::set<std::string> begun_;
};

/// Short enough to read: --json has every digit. Degrees may be coordinates, large numbers counts
/// or times: they keep their digits ("px or deg" may be either).
std::string number_text(double number, const pb::FieldDescriptor& field) {
  const std::string& unit = field.options().GetExtension(fiona::unit);
  const bool long_one = std::abs(number) >= 1e5 || unit == "deg" || unit.ends_with(" deg");
  return fmt::format("{:.{}g}", number, long_one ? 12 : 5);
}

std::string scalar_text(const pb::Message& object, const pb::FieldDescriptor& field, int index) {
  const pb::Reflection& reflection = *object.GetReflection();
  const bool repeated = field.is_repeated();
  switch (field.cpp_type()) {
    case pb::FieldDescriptor::CPPTYPE_INT32:
      return fmt::format(
          "{}", repeated ? reflection.GetRepeatedInt32(object, &field, index) : reflection.GetInt32(object, &field));
    case pb::FieldDescriptor::CPPTYPE_INT64:
      return fmt::format(
          "{}", repeated ? reflection.GetRepeatedInt64(object, &field, index) : reflection.GetInt64(object, &field));
    case pb::FieldDescriptor::CPPTYPE_UINT32:
      return fmt::format(
          "{}", repeated ? reflection.GetRepeatedUInt32(object, &field, index) : reflection.GetUInt32(object, &field));
    case pb::FieldDescriptor::CPPTYPE_UINT64:
      return fmt::format(
          "{}", repeated ? reflection.GetRepeatedUInt64(object, &field, index) : reflection.GetUInt64(object, &field));
    case pb::FieldDescriptor::CPPTYPE_DOUBLE:
      return number_text(
          repeated ? reflection.GetRepeatedDouble(object, &field, index) : reflection.GetDouble(object, &field), field);
    case pb::FieldDescriptor::CPPTYPE_FLOAT:
      return number_text(
          repeated ? reflection.GetRepeatedFloat(object, &field, index) : reflection.GetFloat(object, &field), field);
    case pb::FieldDescriptor::CPPTYPE_BOOL:
      return (repeated ? reflection.GetRepeatedBool(object, &field, index) : reflection.GetBool(object, &field))
                 ? "true"
                 : "false";
    case pb::FieldDescriptor::CPPTYPE_ENUM: {
      const int number =
          repeated ? reflection.GetRepeatedEnumValue(object, &field, index) : reflection.GetEnumValue(object, &field);
      const auto* value = field.enum_type()->FindValueByNumber(number);
      return value == nullptr ? fmt::format("{}", number) : value->name();
    }
    case pb::FieldDescriptor::CPPTYPE_STRING: {
      const std::string text =
          repeated ? reflection.GetRepeatedString(object, &field, index) : reflection.GetString(object, &field);
      return field.type() == pb::FieldDescriptor::TYPE_BYTES ? fmt::format("<{} bytes>", text.size())
                                                             : fmt::format("\"{}\"", text);
    }
    case pb::FieldDescriptor::CPPTYPE_MESSAGE: break;
  }
  return "{}";
}

bool is_below(std::string_view path, std::string_view above) {
  return path == above || (path.starts_with(above) && (path[above.size()] == '.' || path[above.size()] == '['));
}

class Flattener {
 public:
  Flattener(const std::vector<std::string>& wanted, int most_elements, Secrets secrets)
      : wanted_(wanted), most_elements_(most_elements), secrets_(secrets) {}

  void walk(const pb::Message& object, const std::string& prefix, int depth) {
    const pb::Descriptor& type = *object.GetDescriptor();
    for (int i = 0; i < type.field_count() && depth < kDeepest; ++i) take(object, *type.field(i), prefix, depth);
  }

  std::vector<FieldText> found;

 private:
  bool passes(const std::string& path, bool inner) const {
    return wanted_.empty() || std::any_of(wanted_.begin(), wanted_.end(), [&path, inner](const std::string& want) {
             return is_below(path, want) || (inner && is_below(want, path));
           });
  }

  void take(const pb::Message& object, const pb::FieldDescriptor& field, const std::string& prefix, int depth) {
    const std::string path = prefix + field.name();
    const pb::Reflection& reflection = *object.GetReflection();
    const bool nested = field.cpp_type() == pb::FieldDescriptor::CPPTYPE_MESSAGE;
    if (!passes(path, nested || field.is_repeated())) return;
    if (secrets_ == Secrets::Hidden && is_secret(field) && is_set(object, field))
      return found.push_back({path, "(secret)", ""});
    if (field.is_repeated()) return take_list(object, field, path, depth);
    if (field.has_presence() && !reflection.HasField(object, &field)) return;
    if (nested) return walk(reflection.GetMessage(object, &field), path + ".", depth + 1);
    found.push_back({path, scalar_text(object, field, 0), field.options().GetExtension(fiona::unit)});
  }

  static bool is_set(const pb::Message& object, const pb::FieldDescriptor& field) {
    const pb::Reflection& reflection = *object.GetReflection();
    return field.is_repeated() ? reflection.FieldSize(object, &field) > 0 : reflection.HasField(object, &field);
  }

  void take_list(const pb::Message& object, const pb::FieldDescriptor& field, const std::string& path, int depth) {
    const pb::Reflection& reflection = *object.GetReflection();
    const int size = reflection.FieldSize(object, &field);
    const int shown = std::min(size, most_elements_);
    const std::string unit = field.options().GetExtension(fiona::unit);
    if (field.cpp_type() == pb::FieldDescriptor::CPPTYPE_MESSAGE) {
      for (int i = 0; i < shown; ++i) {
        const std::string element = fmt::format("{}[{}]", path, i);
        if (passes(element, true)) walk(reflection.GetRepeatedMessage(object, &field, i), element + ".", depth + 1);
      }
      if (size > shown) found.push_back({path, fmt::format("… {} more", size - shown), ""});
      return;
    }
    const std::string* element = nullptr;
    for (const std::string& want : wanted_) {
      if (want.starts_with(path + "[")) element = &want;
    }
    if (element != nullptr) {
      const int index = std::atoi(element->c_str() + path.size() + 1);
      if (index >= 0 && index < size) found.push_back({*element, scalar_text(object, field, index), unit});
      return;
    }
    std::vector<std::string> texts;
    for (int i = 0; i < shown; ++i) texts.push_back(scalar_text(object, field, i));
    if (size > shown) texts.push_back(fmt::format("… {} more", size - shown));
    found.push_back({path, fmt::format("[{}]", fmt::join(texts, ", ")), unit});
  }

  const std::vector<std::string>& wanted_;
  const int most_elements_;
  const Secrets secrets_;
};

/// In what protobuf has made of an object of the type.
void hide_secrets(nlohmann::json& json, const pb::Descriptor& type) {
  for (int i = 0; i < type.field_count() && json.is_object(); ++i) {
    const pb::FieldDescriptor& field = *type.field(i);
    const auto at = json.find(field.name());
    if (at == json.end()) continue;
    const pb::Descriptor* below =
        field.is_map() ? field.message_type()->FindFieldByNumber(2)->message_type() : field.message_type();
    if (is_secret(field)) {
      *at = nullptr;
    } else if (below != nullptr && field.is_repeated()) {
      for (nlohmann::json& element : *at) hide_secrets(element, *below);
    } else if (below != nullptr) {
      hide_secrets(*at, *below);
    }
  }
}

std::string type_text(const pb::FieldDescriptor& field) {
  const std::string base = field.message_type() != nullptr ? field.message_type()->name()
                           : field.enum_type() != nullptr  ? "enum " + field.enum_type()->name()
                                                           : field.type_name();
  const auto& options = field.options();
  if (!field.is_repeated()) return field.has_optional_keyword() ? base + ", optional" : base;
  if (options.GetExtension(fiona::size) > 0) return fmt::format("{}[{}]", base, options.GetExtension(fiona::size));
  return options.GetExtension(fiona::max_size) > 0
             ? fmt::format("{}[up to {}]", base, options.GetExtension(fiona::max_size))
             : base + "[]";
}

/// Whole ones in full, others to six digits.
std::string bound_text(double bound) {
  constexpr double kWhole = 1e15;
  return std::trunc(bound) == bound && std::abs(bound) < kWhole ? fmt::format("{:.0f}", bound)
                                                                : fmt::format("{:g}", bound);
}

std::string range_text(const pb::FieldDescriptor& field) {
  const auto& options = field.options();
  const bool low = options.HasExtension(fiona::min);
  const bool high = options.HasExtension(fiona::max);
  const std::string from = bound_text(options.GetExtension(fiona::min));
  const std::string to = bound_text(options.GetExtension(fiona::max));
  std::string text = low && high ? from + " .. " + to : low ? "from " + from : high ? "up to " + to : "";
  if (options.HasExtension(fiona::step))
    text += (text.empty() ? "" : ", ") + ("in steps of " + bound_text(options.GetExtension(fiona::step)));
  if (!text.empty() || field.enum_type() == nullptr) return text;
  std::vector<std::string> names;
  for (int i = 0; i < field.enum_type()->value_count(); ++i) names.push_back(field.enum_type()->value(i)->name());
  return fmt::format("{}", fmt::join(names, "|"));
}

void add_fields(Table& table, const pb::Descriptor& type, const std::string& prefix,
                std::vector<const pb::Descriptor*> above) {
  if (std::find(above.begin(), above.end(), &type) != above.end() || above.size() > kDeepest) return;
  above.push_back(&type);
  for (int i = 0; i < type.field_count() && table.size() <= kMostRows; ++i) {
    const pb::FieldDescriptor& field = *type.field(i);
    const auto& options = field.options();
    if (table.size() == kMostRows) return table.add({"…", "", "", "", "the type has more fields"});
    table.add({prefix + field.name(), type_text(field), options.GetExtension(fiona::unit), range_text(field),
               options.GetExtension(fiona::doc)});
    if (field.message_type() != nullptr)
      add_fields(table, *field.message_type(), prefix + field.name() + (field.is_repeated() ? "[]." : "."), above);
  }
}

}  // namespace

TypeSet::TypeSet(const pb::FileDescriptorSet& files)
    : pool_(std::make_unique<pb::DescriptorPool>()), factory_(std::make_unique<pb::DynamicMessageFactory>()) {
  PoolBuilder builder(files, *pool_);
  if (files.file_size() > kMostFiles) {
    throw Error(ErrorCode::Failed, {.what = "too many protos to read their types",
                                    .expected = fmt::format("at most {} files", kMostFiles),
                                    .found = fmt::format("{} files", files.file_size())});
  }
  for (const auto& file : files.file()) builder.add(file.name());
}

const pb::Descriptor* TypeSet::object(const std::string& full_name) const {
  const auto* own = pool_->FindMessageTypeByName(full_name);
  return own != nullptr ? own : pb::DescriptorPool::generated_pool()->FindMessageTypeByName(full_name);
}

const pb::ServiceDescriptor* TypeSet::service(const std::string& full_name) const {
  const auto* own = pool_->FindServiceByName(full_name);
  return own != nullptr ? own : pb::DescriptorPool::generated_pool()->FindServiceByName(full_name);
}

std::unique_ptr<pb::Message> TypeSet::make(const std::string& full_name) const {
  const auto* type = object(full_name);
  return type == nullptr ? nullptr : std::unique_ptr<pb::Message>(factory_->GetPrototype(type)->New());
}

std::vector<FieldText> field_texts(const pb::Message& object, const std::vector<std::string>& wanted, Secrets secrets,
                                   int most_elements) {
  Flattener flattener(wanted, most_elements, secrets);
  flattener.walk(object, "", 0);
  return std::move(flattener.found);
}

bool is_plain_value(std::string_view type) { return type.starts_with("fiona.probe."); }

PathCheck check_path(const pb::Descriptor& type, std::string_view path) {
  const pb::Descriptor* level = &type;
  while (!path.empty()) {
    const std::size_t dot = std::min(path.find('.'), path.size());
    const std::string_view name = path.substr(0, std::min(path.find('['), dot));
    const pb::FieldDescriptor* field = level == nullptr ? nullptr : level->FindFieldByName(std::string(name));
    if (field == nullptr) {
      PathCheck missing{.exists = false, .level = level == nullptr ? "" : level->name(), .known = {}};
      for (int i = 0; level != nullptr && i < level->field_count(); ++i)
        missing.known.push_back(level->field(i)->name());
      return missing;
    }
    level = field->message_type();
    path.remove_prefix(std::min(dot + 1, path.size()));
  }
  return {.exists = true, .level = {}, .known = {}};
}

nlohmann::json object_json(const pb::Message& object, Secrets secrets) {
  pb::util::JsonPrintOptions options;
  options.preserve_proto_field_names = true;
  options.always_print_primitive_fields = true;
  std::string text;
  if (!pb::util::MessageToJsonString(object, &text, options).ok()) return nullptr;
  nlohmann::json json = nlohmann::json::parse(text, nullptr, false);
  if (secrets == Secrets::Hidden) hide_secrets(json, *object.GetDescriptor());
  return json;
}

Table field_table(const pb::Descriptor& type) {
  Table table({"field", "type", "unit", "range", "doc"});
  add_fields(table, type, "", {});
  return table;
}

std::string pattern_text(int pattern) {
  switch (pattern) {
    case fiona::SEND: return "send";
    case fiona::QUERY: return "query";
    case fiona::PUSH_NEWEST: return "push newest";
    case fiona::PUSH_TIMED: return "push timed";
    case fiona::EVENT: return "event";
    default: return "-";
  }
}

}  // namespace fiona::console
