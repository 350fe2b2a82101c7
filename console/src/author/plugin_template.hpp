#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <google/protobuf/descriptor.h>

#include "types.hpp"

namespace fiona::console {

/// What `plugin new` is to write.
struct NewPlugin {
  std::string publisher{};
  std::string name{};
  std::string kind = "plugin";                    ///< a folder of console/templates
  std::map<std::string, std::string> messages{};  ///< packages whose services these are, with their versions
  std::vector<const google::protobuf::ServiceDescriptor*> provided{};
  std::vector<const google::protobuf::ServiceDescriptor*> needed{};
  std::vector<std::shared_ptr<const TypeSet>> types{};  ///< that those of `messages` are among
};

/// The files of console/templates, by path.
const std::map<std::string, std::string, std::less<>>& template_files();

/// The services of the platform's catalogue, by full name: those for which the SDK has types.
std::vector<const google::protobuf::ServiceDescriptor*> platform_services();

/// Why a publisher or plugin cannot be called so, as the end of a sentence; empty if it can: it has to be the name of a
/// package, and with '_' for '-' one of C++ and of proto.
std::string plugin_name_fault(std::string_view name);

/// What the port of a service is called at first: "location" of LocationProvider, "imu" of GetIMUService.
std::string port_name_of(std::string_view service);

/// The files of the new plugin, by their path in its folder.
std::map<std::filesystem::path, std::string> new_plugin_files(const NewPlugin& plugin);

}  // namespace fiona::console
