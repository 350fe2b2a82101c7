// Requirements, bounds of versions and locks from strangers: one clear error without a control character in it, or what
// reads the same when it is written again.
#include <google/protobuf/text_format.h>

#include <cstdint>
#include <cstdlib>
#include <fiona/error.hpp>
#include <fiona/marketplace/lock.hpp>
#include <fiona/marketplace/requirement.hpp>
#include <string>
#include <string_view>

namespace {

using namespace fiona::marketplace;

std::string written(std::string_view text, int kind) {
  if (kind == 0) return Requirement::parse(text, "fuzz").text();
  if (kind == 1) {
    const VersionRange range = VersionRange::parse(text, "fuzz");
    for (const auto& bound : range.bounds()) range.has(bound.version);
    return range.text();
  }
  std::string printed;
  google::protobuf::TextFormat::PrintToString(parse_lock(text, "fuzz"), &printed);
  return printed;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view text{reinterpret_cast<const char*>(data) + 1, size - 1};
  const int kind = data[0] % 3;
  try {
    const std::string once = written(text, kind);
    if (written(once, kind) != once) std::abort();
  } catch (const fiona::Error& error) {
    for (const char c : std::string_view(error.what())) {
      if ((c >= 0 && c < ' ' && c != '\n') || c == 0x7f) std::abort();
    }
  }
  return 0;
}
