// Metadata of a TUF repository: nothing in it may do harm, and its canonical form, which is what signatures are of,
// means the same as the text that it was read from.
#include <cstdint>
#include <cstdlib>
#include <fiona/error.hpp>

#include "tuf/metadata.hpp"

namespace {

using fiona::tuf::Json;

// Canonical JSON has control characters as they are, which ordinary readers refuse; they stand in strings only.
std::string readable(const std::string& canonical) {
  std::string text;
  for (const char c : canonical) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x20) {
      text += c;
    } else {
      text += std::string("\\u00") + "01"[byte / 16] + "0123456789abcdef"[byte % 16];
    }
  }
  return text;
}

void check_canonical(std::string_view bytes) {
  Json value;
  try {
    value = fiona::tuf::parse_json(bytes, "input");
  } catch (const fiona::Error&) {
    return;
  }
  const std::string canonical = fiona::tuf::canonical(value);
  const Json again = fiona::tuf::parse_json(readable(canonical), "canonical form");
  if (again != value || fiona::tuf::canonical(again) != canonical) std::abort();
}

template <typename Parse>
void check_role(Parse&& parse, std::string_view bytes) {
  try {
    const auto file = parse(bytes, "input");
    if (file.version < 1 || file.signed_bytes.empty()) std::abort();
    if (fiona::tuf::parse_time(fiona::tuf::time_text(file.expires), "again") != file.expires) std::abort();
  } catch (const fiona::Error& error) {
    for (const char c : std::string_view(error.what())) {
      if ((c >= 0 && c < ' ' && c != '\n') || c == 0x7f) std::abort();
    }
  }
}

void check_delegations(std::string_view bytes) {
  try {
    for (const auto& delegation : fiona::tuf::parse_targets(bytes, "input").delegations)
      delegation.covers("acme/x-1.0.0");
  } catch (const fiona::Error&) {
    // As above.
  }
}

// Whether it is signed as it says itself.
void check_signatures(std::string_view bytes) {
  try {
    const auto root = fiona::tuf::parse_root(bytes, "input");
    for (const auto& [role, signers] : root.roles) fiona::tuf::require_signatures(root, signers, root.keys, role);
  } catch (const fiona::Error&) {
    // As above.
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes{reinterpret_cast<const char*>(data), size};
  check_canonical(bytes);
  check_role(fiona::tuf::parse_root, bytes);
  check_role(fiona::tuf::parse_timestamp, bytes);
  check_role(fiona::tuf::parse_snapshot, bytes);
  check_role(fiona::tuf::parse_targets, bytes);
  check_delegations(bytes);
  check_signatures(bytes);
  return 0;
}
