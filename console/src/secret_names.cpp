#include "secret_names.hpp"

#include <algorithm>
#include <vector>

#include <fiona/secrets.hpp>

namespace fiona::console {
namespace {

namespace pb = google::protobuf;

bool is_in_name(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
}

/// Where the value of `name=value` begins; npos: none follows.
std::size_t after_equals(std::string_view line, std::size_t name_end) {
  const std::size_t equals = line.find_first_not_of("[]0123456789", name_end);
  const bool follows =
      equals != std::string_view::npos && line[equals] == '=' && !line.substr(equals).starts_with("==");
  return follows ? equals + 1 : std::string_view::npos;
}

/// The same of `name: value` and `name {`, or where a sign was forgotten.
std::size_t after_blank(std::string_view line, std::size_t name, std::size_t name_end) {
  if (name > 0 && line[name - 1] == '.') return std::string_view::npos;  // of a port
  const std::size_t value = std::min(line.find_first_not_of(" \t\r\n\\:{<", name_end), line.size());
  return value > name_end ? value : std::string_view::npos;
}

}  // namespace

void SecretNames::learn(const pb::Descriptor& type) {
  std::vector<const pb::Descriptor*> types{&type};
  for (std::size_t at = 0; at < types.size(); ++at) {
    for (int i = 0; i < types[at]->field_count(); ++i) {
      const pb::FieldDescriptor& field = *types[at]->field(i);
      if (is_secret(field)) names_.insert(field.name());
      const auto* below = field.message_type();
      if (below != nullptr && std::find(types.begin(), types.end(), below) == types.end()) types.push_back(below);
    }
  }
}

std::size_t SecretNames::begin_in(std::string_view line) const {
  const std::size_t verb = std::min(line.find_first_not_of(" \t"), line.size());
  bool has_fields = line.substr(verb).starts_with("call ") || line.substr(verb).starts_with("send ");
  for (std::size_t at = 0, end = 0; at < line.size(); at = std::max(end, at + 1)) {
    has_fields = has_fields || line[at] == '{';
    for (end = at; end < line.size() && is_in_name(line[end]);) ++end;
    if (end == at || !names_.contains(line.substr(at, end - at))) continue;
    const std::size_t value = after_equals(line, end);
    if (value != std::string_view::npos) return value;
    const std::size_t other = has_fields ? after_blank(line, at, end) : std::string_view::npos;
    if (other != std::string_view::npos) return other;
  }
  return std::string_view::npos;
}

}  // namespace fiona::console
