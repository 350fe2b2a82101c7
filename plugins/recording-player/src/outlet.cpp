#include "outlet.hpp"

#include <algorithm>
#include <set>
#include <vector>

#include "fiona/options.pb.h"

namespace fiona::recording_player {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;

bool is_time(const FieldDescriptor& field) {
  return field.type() == FieldDescriptor::TYPE_INT64 && field.options().GetExtension(unit) == "ms";
}

bool has_times(const Descriptor& type, std::set<const Descriptor*>& seen) {
  if (!seen.insert(&type).second) return false;
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (is_time(field) || (field.message_type() && has_times(*field.message_type(), seen))) return true;
  }
  return false;
}

/// Where the clock has just begun, what was true before that was true at its beginning: there are no times below 0.
std::int64_t later(std::int64_t time_ms, std::int64_t by_ms) {
  std::int64_t sum = 0;
  if (time_ms < 0 || __builtin_add_overflow(time_ms, by_ms, &sum)) return time_ms;
  return std::max<std::int64_t>(0, sum);
}

}  // namespace

bool has_times(const Descriptor& type) {
  std::set<const Descriptor*> seen;
  return has_times(type, seen);
}

/// Protobuf's parser bounds how deep objects lie in each other.
void shift_times(Message& object, std::int64_t by_ms) {
  const auto& reflection = *object.GetReflection();
  std::vector<const FieldDescriptor*> fields;
  reflection.ListFields(object, &fields);
  for (const FieldDescriptor* field : fields) {
    const int size = field->is_repeated() ? reflection.FieldSize(object, field) : 1;
    for (int i = 0; i < size; ++i) {
      if (field->message_type()) {
        shift_times(field->is_repeated() ? *reflection.MutableRepeatedMessage(&object, field, i)
                                         : *reflection.MutableMessage(&object, field),
                    by_ms);
      } else if (is_time(*field) && field->is_repeated()) {
        reflection.SetRepeatedInt64(&object, field, i, later(reflection.GetRepeatedInt64(object, field, i), by_ms));
      } else if (is_time(*field)) {
        reflection.SetInt64(&object, field, later(reflection.GetInt64(object, field), by_ms));
      }
    }
  }
}

}  // namespace fiona::recording_player
