#include "names.hpp"

namespace fiona::host {

PortKey key_of(const control::PortName& name) { return {name.instance(), name.port()}; }

control::PortName port_of(const PortKey& key) {
  control::PortName name;
  name.set_instance(key.first);
  name.set_port(key.second);
  return name;
}

std::string text_of(const control::PortName& name) { return name.instance() + "." + name.port(); }

}  // namespace fiona::host
