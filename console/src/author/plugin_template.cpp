#include "author/plugin_template.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <set>

#include <fmt/format.h>
#include <fiona/describe.hpp>
#include <fiona/marketplace/manifest.hpp>
#include <fiona/service.hpp>

#include "fiona/hmi.pb.h"
#include "fiona/localisation.pb.h"
#include "fiona/navigation.pb.h"
#include "fiona/perception.pb.h"
#include "fiona/security.pb.h"
#include "fiona/sensors.pb.h"

namespace fiona::console {
namespace {

using google::protobuf::ServiceDescriptor;
using Values = std::map<std::string, std::string, std::less<>>;

// C++20 [lex.key] and [lex.digraph]; what protoc renames, or a namespace of that name would hide; targets that CMake
// has.
constexpr std::array kTaken{
    "alignas",   "alignof",  "and",       "asm",       "auto",      "bitand",   "bitor",    "bool",      "break",
    "case",      "catch",    "char",      "class",     "compl",     "concept",  "const",    "consteval", "constexpr",
    "constinit", "continue", "decltype",  "default",   "delete",    "do",       "double",   "else",      "enum",
    "explicit",  "export",   "extern",    "false",     "float",     "for",      "friend",   "goto",      "if",
    "inline",    "int",      "long",      "mutable",   "namespace", "new",      "noexcept", "not",       "nullptr",
    "operator",  "or",       "private",   "protected", "public",    "register", "requires", "return",    "short",
    "signed",    "sizeof",   "static",    "struct",    "switch",    "template", "this",     "throw",     "true",
    "try",       "typedef",  "typeid",    "typename",  "union",     "unsigned", "using",    "virtual",   "void",
    "volatile",  "while",    "xor",       "std",       "fiona",     "google",   "testing",  "test",      "main",
    "plugin",    "params",   "component", "linux",     "unix",      "all",      "help",     "install",   "preinstall",
    "clean"};

std::string with_underscores(std::string_view name) {
  std::string text(name);
  std::replace(text.begin(), text.end(), '-', '_');
  return text;
}

/// "step_counter" -> "StepCounter".
std::string pascal_case(std::string_view name) {
  std::string text;
  bool begins = true;
  for (const char letter : name) {
    if (letter == '_' || letter == '-') {
      begins = true;
      continue;
    }
    text += begins ? static_cast<char>(std::toupper(static_cast<unsigned char>(letter))) : letter;
    begins = false;
  }
  return text;
}

/// "RFSignalRSSI" -> "rf_signal_rssi".
std::string snake_case(std::string_view name) {
  const auto upper = [&](std::size_t at) {
    return at < name.size() && std::isupper(static_cast<unsigned char>(name[at])) != 0;
  };
  std::string text;
  for (std::size_t i = 0; i < name.size(); ++i) {
    const bool word = upper(i) && (!upper(i - 1) || (i + 1 < name.size() && !upper(i + 1)));
    if (i > 0 && word) text += '_';
    text += static_cast<char>(std::tolower(static_cast<unsigned char>(name[i])));
  }
  return text;
}

std::string cpp_type(const google::protobuf::Descriptor& type) {
  std::string text = type.full_name();
  for (std::size_t dot = text.find('.'); dot != std::string::npos; dot = text.find('.', dot))
    text.replace(dot, 1, "::");
  return text;
}

/// The text with each `@key@` that is known replaced.
std::string filled(std::string_view text, const Values& values) {
  std::string out;
  while (!text.empty()) {
    const std::size_t begin = text.find('@');
    const std::size_t end = begin == std::string_view::npos ? begin : text.find('@', begin + 1);
    if (end == std::string_view::npos) break;
    const auto value = values.find(text.substr(begin + 1, end - begin - 1));
    out += text.substr(0, begin);
    if (value == values.end()) {
      out += '@';
      text.remove_prefix(begin + 1);
    } else {
      out += value->second;
      text.remove_prefix(end + 1);
    }
  }
  return out.append(text);
}

/// The parts of ports.txt: "provides query: members" -> text.
Values port_parts() {
  Values parts;
  std::string* part = nullptr;
  std::string_view text = template_files().at("plugin/ports.txt");
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size() - 1) + 1;
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(end);
    if (line.starts_with("== ")) {
      part = &parts[std::string(line.substr(3, line.size() - 4))];
    } else if (part != nullptr) {
      part->append(line);
    }
  }
  return parts;
}

/// What a port brings: its values over those of the plugin, and under which head its parts stand.
struct NewPort {
  std::string head;
  Values values;
};

/// A service that is provided and required, or asked for twice, gives ports of two names.
std::string unused_name(const std::string& name, std::set<std::string>& used) {
  std::string free = name;
  for (int number = 2; !used.insert(free).second; ++number) free = fmt::format("{}_{}", name, number);
  return free;
}

NewPort new_port(const ServiceDescriptor& descriptor, bool provides, std::set<std::string>& used) {
  const ServiceInfo service(descriptor);
  NewPort port;
  const std::string pattern{to_string(service.pattern())};
  port.head = provides ? "provides " + pattern : service.is_push() ? "requires push" : "requires " + pattern;
  const std::uint32_t lease = service.contract().lease_ms();
  const std::uint32_t period = service.contract().period_ms() != 0 ? service.contract().period_ms()
                               : lease != 0                        ? std::max(1U, lease / 4)
                                                                   : 1000U;
  std::string type = descriptor.full_name();
  for (std::size_t dot = type.find('.'); dot != std::string::npos; dot = type.find('.', dot))
    type.replace(dot, 1, "::");
  port.values = {
      {"port", unused_name(port_name_of(descriptor.name()), used)},
      {"service", type},
      {"name of service", descriptor.name()},
      {"pattern", pattern},
      {"direction", provides ? "provides" : "requires"},
      {"object", cpp_type(service.object())},
      {"Object", service.object().name()},
      {"period", fmt::format("{}", period)},
      {"every", period % 1000 == 0 ? fmt::format("every {} s", period / 1000) : fmt::format("every {} ms", period)}};
  port.values["Port"] = pascal_case(port.values["port"]);
  if (service.pattern() == QUERY) {
    port.values["request"] = cpp_type(service.object());
    port.values["answer"] = cpp_type(*service.answer());
  } else if (service.pattern() == EVENT) {
    port.values["activation"] = cpp_type(service.object());
    port.values["result"] = cpp_type(*service.answer());
    port.values["state"] = cpp_type(*descriptor.FindMethodByName("State")->input_type());
  }
  return port;
}

std::vector<NewPort> new_ports(const NewPlugin& plugin) {
  std::set<std::string> used;
  std::vector<NewPort> ports;
  for (const auto* service : plugin.provided) ports.push_back(new_port(*service, true, used));
  for (const auto* service : plugin.needed) ports.push_back(new_port(*service, false, used));
  return ports;
}

std::string includes_of(const NewPlugin& plugin, const std::string& folder) {
  std::set<std::string> headers{"fiona/component.hpp"};
  for (const auto& services : {plugin.provided, plugin.needed}) {
    for (const auto* service : services) {
      const std::string& file = service->file()->name();
      headers.insert(file.substr(0, file.rfind('.')) + ".fiona.hpp");
    }
  }
  std::string text = "#include <cstdint>\n#include <optional>\n\n";
  for (const std::string& header : headers) text += fmt::format("#include <{}>\n", header);
  return text + fmt::format("\n#include \"{}/params.pb.h\"\n", folder);
}

/// What the build and the manifest have to say of packages whose objects it is compiled with.
void add_messages(const NewPlugin& plugin, Values& values) {
  std::string names, targets, requirements;
  for (const auto& [package, version] : plugin.messages) {
    names += " " + package;
    targets += " " + std::string(package).replace(package.find('/'), 1, "::");
    requirements += fmt::format("requirements: \"{} >= {}\"\n", package, version);
  }
  values["find messages"] = names.empty() ? "" : fmt::format("fiona_find_messages({})\n", names.substr(1));
  values["message targets"] = targets;
  values["messages"] = names.empty() ? "" : "\n                 MESSAGES" + names;
  values["requirements"] = requirements;
}

Values values_of(const NewPlugin& plugin) {
  const std::string file = with_underscores(plugin.name);
  const std::string publisher = with_underscores(plugin.publisher);
  Values values{{"name", plugin.name},
                {"publisher", plugin.publisher},
                {"file", file},
                {"Class", pascal_case(file)},
                {"folder", publisher + "/" + file},
                {"package", publisher + "." + file},
                {"namespace", publisher + "::" + file}};
  values["includes"] = includes_of(plugin, values["folder"]);
  add_messages(plugin, values);
  const Values parts = port_parts();
  std::vector<NewPort> ports = new_ports(plugin);
  if (ports.empty()) ports.push_back({"none", {}});
  std::string state;
  for (const NewPort& port : ports) {
    Values all = values;
    for (const auto& [key, value] : port.values) all[key] = value;
    const auto part = [&](const std::string& name) {
      const auto found = parts.find(port.head + ": " + name);
      return found == parts.end() ? std::string() : filled(found->second, all);
    };
    for (const char* name : {"declarations", "members", "definitions", "tests"}) values[name] += part(name);
    state += part("state");
    if (port.head != "none")
      values["rows"] += filled("| `@port@` @direction@ | @name of service@ | @pattern@ |\n", all);
    else
      values["rows"] += "| | | |\n";
  }
  if (!state.empty()) values["members"] = "\n" + state + values["members"];
  return values;
}

}  // namespace

std::vector<const ServiceDescriptor*> platform_services() {
  // Naming a message of each file of the catalogue links it; control and link protocols have no services.
  std::vector<const ServiceDescriptor*> services;
  for (const auto* file :
       {hmi::NextTurn::descriptor()->file(), localisation::CommLocation::descriptor()->file(),
        navigation::CommDestination::descriptor()->file(), perception::CommObstacle::descriptor()->file(),
        security::CommAuthenticationRequest::descriptor()->file(), sensors::GetIMU::descriptor()->file()}) {
    for (int i = 0; i < file->service_count(); ++i) services.push_back(file->service(i));
  }
  return services;
}

std::string plugin_name_fault(std::string_view name) {
  if (!marketplace::is_name(name))
    return "is not at most 64 lower-case letters, digits and '-' that begin with a letter";
  if (name.find("--") != std::string_view::npos || name.back() == '-')
    return "has a '-' that is not between two letters or digits, which C++ keeps for itself";
  if (std::find(kTaken.begin(), kTaken.end(), with_underscores(name)) != kTaken.end())
    return "is a word that C++, the platform or its tests have taken";
  return "";
}

std::string port_name_of(std::string_view service) {
  for (const std::string_view ending : {"Service", "Provider", "Input", "Detected"}) {
    if (service.ends_with(ending) && service.size() > ending.size()) {
      service.remove_suffix(ending.size());
      break;
    }
  }
  if (service.starts_with("Get") && service.size() > 3) service.remove_prefix(3);
  return snake_case(service);
}

std::map<std::filesystem::path, std::string> new_plugin_files(const NewPlugin& plugin) {
  const Values values = values_of(plugin);
  const std::string& file = values.at("file");
  const std::map<std::string, std::filesystem::path> places{
      {"system.fiona", plugin.name + ".fiona"},
      {"objects.proto", "proto/" + values.at("folder") + "/objects.proto"},
      {"CMakeLists.txt", "CMakeLists.txt"},
      {"manifest.textproto", "manifest.textproto"},
      {"README.md", "README.md"},
      {"gitignore", ".gitignore"},
      {"params.proto", "proto/" + values.at("folder") + "/params.proto"},
      {"component.hpp.in", "src/" + file + ".hpp"},
      {"component.cpp.in", "src/" + file + ".cpp"},
      {"plugin.cpp.in", "src/plugin.cpp"},
      {"test.cpp.in", "test/" + file + "_test.cpp"}};
  std::map<std::filesystem::path, std::string> files;
  for (const auto& [name, place] : places) {
    const auto found = template_files().find(plugin.kind + "/" + name);
    if (found != template_files().end()) files[place] = filled(found->second, values);
  }
  return files;
}

}  // namespace fiona::console
