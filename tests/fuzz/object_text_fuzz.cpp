// Types and objects that the console has never seen: whatever descriptors a stranger's plugin brings, they are refused
// with a fiona::Error, or their objects are told as rows, as JSON and as a table, all of bounded size.
#include <google/protobuf/stubs/logging.h>

#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "fiona/error.hpp"
#include "inert.hpp"
#include "types.hpp"

namespace {

using fiona::console::FieldText;

void check_object(const google::protobuf::Message& object) {
  for (const FieldText& field : fiona::console::field_texts(object, {})) {
    if (!fiona::console::check_path(*object.GetDescriptor(), field.path).exists) std::abort();
    const std::string text = fiona::console::inert_lines(field.text);
    if (fiona::console::inert_lines(text) != text) std::abort();
    // Asked for by its path, a field is told again.
    if (fiona::console::field_texts(object, {field.path}).empty()) std::abort();
    (void)fiona::console::field_texts(object, {field.path + "[0]"});
    if (fiona::console::check_path(*object.GetDescriptor(), field.path + ".no_field").exists) std::abort();
  }
  (void)fiona::console::object_json(object).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

void check_type(const fiona::console::TypeSet& types, const google::protobuf::Descriptor& type,
                std::string_view bytes) {
  (void)fiona::console::field_table(type);
  const auto object = types.make(type.full_name());
  if (!object) std::abort();
  if (object->ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) check_object(*object);
}

}  // namespace

// The first two bytes: how long the descriptors are; then these, then an object of each of their types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto kLogBefore = google::protobuf::SetLogHandler(nullptr);  // it tells of each garbled message
  static_cast<void>(kLogBefore);
  if (size < 2) return 0;
  std::string_view rest(reinterpret_cast<const char*>(data) + 2, size - 2);
  const std::string_view descriptors = rest.substr(0, 256U * data[0] + data[1]);
  rest.remove_prefix(descriptors.size());
  google::protobuf::FileDescriptorSet files;
  if (!files.ParseFromArray(descriptors.data(), static_cast<int>(descriptors.size()))) return 0;
  try {
    const fiona::console::TypeSet types(files);
    for (const auto& file : files.file()) {
      const std::string package = file.package().empty() ? "" : file.package() + ".";
      for (const auto& type : file.message_type()) check_type(types, *types.object(package + type.name()), rest);
      for (const auto& service : file.service()) {
        if (types.service(package + service.name()) == nullptr) std::abort();
        (void)fiona::console::is_plain_value(service.name());
      }
    }
  } catch (const fiona::Error&) {
  }
  return 0;
}
