#include "names.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>

#include "fiona/error.hpp"

namespace fiona::host {

PortKey key_of(const control::PortName& name) { return {name.instance(), name.port()}; }

control::PortName port_of(const PortKey& key) {
  control::PortName name;
  name.set_instance(key.first);
  name.set_port(key.second);
  return name;
}

std::string text_of(const control::PortName& name) { return name.instance() + "." + name.port(); }

void require_name(const std::string& name, std::string_view kind) {
  const auto allowed = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '-' || c == '_'; };
  const bool good = !name.empty() && name.size() <= 64 && std::isalpha(static_cast<unsigned char>(name[0])) &&
                    std::all_of(name.begin(), name.end(), allowed) && name != kHostItself;
  if (good) return;
  throw Error(ErrorCode::Usage, {.what = fmt::format("'{}' is no name for {}", name, kind),
                                 .expected = "a letter, then letters, digits, '-' and '_', at most 64; not 'host'"});
}

}  // namespace fiona::host
