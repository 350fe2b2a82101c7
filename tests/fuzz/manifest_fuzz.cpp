// Manifests and interfaces from strangers: whatever the bytes, one clear error without a control character in
// it, or a message that can be printed and read again.
#include <google/protobuf/text_format.h>

#include <cstdint>
#include <cstdlib>
#include <fiona/error.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/marketplace/version.hpp>
#include <string>
#include <string_view>

namespace {

using namespace fiona::marketplace;

template <typename Parse>
void check(Parse&& parse, std::string_view text) {
  try {
    const auto message = parse(text, "fuzz");
    std::string printed;
    google::protobuf::TextFormat::PrintToString(message, &printed);
    parse(printed, "fuzz");
  } catch (const fiona::Error& error) {
    for (const char c : std::string_view(error.what())) {
      if ((c >= 0 && c < ' ' && c != '\n') || c == 0x7f) std::abort();
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view text{reinterpret_cast<const char*>(data) + 1, size - 1};
  switch (data[0] % 3) {
    case 0:
      check(
          [](auto... arguments) {
            const auto manifest = parse_manifest(arguments...);
            for (const auto& right : manifest.rights()) opens_sandbox(right);
            check_packed_manifest(manifest, "fuzz");
            return manifest;
          },
          text);
      break;
    case 1: check([](auto... arguments) { return parse_interface(arguments...); }, text); break;
    default:
      if (const auto version = Version::parse(text); version && *version != *Version::parse(version->text()))
        std::abort();
  }
  return 0;
}
