// Objects from other processes: bytes of any platform type that parse have a verdict, which survives being sent on; and
// a value as a console sends it is refused in a sentence, or leaves an object within its rules.
#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>
#include <google/protobuf/stubs/logging.h>

#include <cstdint>
#include <cstdlib>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/error.hpp"
#include "fiona/hmi.pb.h"
#include "fiona/localisation.pb.h"
#include "fiona/navigation.pb.h"
#include "fiona/params.hpp"
#include "fiona/perception.pb.h"
#include "fiona/rules.hpp"
#include "fiona/sensors.pb.h"

namespace {

using google::protobuf::Descriptor;
using google::protobuf::Message;

struct Type {
  const Descriptor* descriptor;
  std::unique_ptr<fiona::ObjectRules> rules;
};

std::vector<Type> platform_types() {
  std::vector<Type> types;
  for (const Descriptor* one : {fiona::sensors::GetIMU::descriptor(), fiona::localisation::CommLocation::descriptor(),
                                fiona::navigation::CommRasterMap::descriptor(),
                                fiona::perception::CommObstacle::descriptor(), fiona::hmi::NextTurn::descriptor()}) {
    const auto* file = one->file();
    for (int i = 0; i < file->message_type_count(); ++i) {
      types.push_back({file->message_type(i), std::make_unique<fiona::ObjectRules>(*file->message_type(i))});
    }
  }
  return types;
}

std::unique_ptr<Message> made(const Descriptor& type) {
  return std::unique_ptr<Message>(google::protobuf::MessageFactory::generated_factory()->GetPrototype(&type)->New());
}

void check_verdict(const Type& type, std::string_view bytes) {
  const auto object = made(*type.descriptor);
  if (!object->ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
  const auto verdict = type.rules->first_violation(*object);
  if (verdict && verdict->empty()) std::abort();
  const auto sent_on = made(*type.descriptor);
  if (!sent_on->ParseFromString(object->SerializeAsString()) || type.rules->first_violation(*sent_on) != verdict) {
    std::abort();
  }
}

void check_set(const Type& type, std::string_view bytes) {
  fiona::control::Set set;
  if (!set.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
  const auto draft = made(*type.descriptor);
  try {
    fiona::set_fields(*draft, std::vector(set.parameters().begin(), set.parameters().end()));
    if (type.rules->first_violation(*draft)) std::abort();
    const auto again = made(*type.descriptor);
    fiona::set_fields(*again, fiona::differences(*draft, *again));
  } catch (const fiona::Error& error) {
    if (error.text().what.empty()) std::abort();
  }
}

}  // namespace

// The first byte: the type; the second: which of the two.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto kLogBefore = google::protobuf::SetLogHandler(nullptr);  // it tells of each garbled message
  static_cast<void>(kLogBefore);
  static const std::vector<Type> kTypes = platform_types();
  if (size < 2) return 0;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 2, size - 2);
  const Type& type = kTypes[data[0] % kTypes.size()];
  data[1] % 2 == 0 ? check_verdict(type, bytes) : check_set(type, bytes);
  return 0;
}
