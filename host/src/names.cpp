#include "names.hpp"

#include <algorithm>

namespace fiona::host {

PortKey key_of(const control::PortName& name) { return {name.instance(), name.port()}; }

control::PortName port_of(const PortKey& key) {
  control::PortName name;
  name.set_instance(key.first);
  name.set_port(key.second);
  return name;
}

std::string text_of(const control::PortName& name) { return name.instance() + "." + name.port(); }

control::PortName port_named(const std::string& text) {
  const std::size_t dot = std::min(text.find('.'), text.size());
  return port_of({text.substr(0, dot), text.substr(std::min(dot + 1, text.size()))});
}

}  // namespace fiona::host
