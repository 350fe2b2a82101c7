#pragma once

#include <google/protobuf/descriptor.h>
#include <google/protobuf/dynamic_message.h>

#include <map>
#include <memory>
#include <shared_mutex>
#include <string>
#include <vector>

#include "fiona/control.pb.h"
#include "fiona/manifest.pb.h"

namespace fiona::host {

/// The services and objects that the system knows: the platform's, and those that the interfaces of loaded plugins
/// carry. Never needs a plugin's code. All functions [any thread].
class Types {
 public:
  Types();
  ~Types();

  class Source;
  /// A plugin's own protos, which become known with `add`. Throws Error when they do not fit together.
  static std::shared_ptr<const Source> read(const std::string& plugin, const Interface& interface);
  /// Learns a plugin's protos, instead of those of an earlier build of it.
  void add(const std::string& plugin, std::shared_ptr<const Source> source);

  /// The service as the plugin has it; null if unknown. It lives as long as the source.
  static const google::protobuf::ServiceDescriptor* service(const Source& source, const std::string& full_name);
  /// An empty object of this type; null if unknown. It keeps what it was made of alive: a plugin may be replaced
  /// before.
  static std::shared_ptr<google::protobuf::Message> make(const std::shared_ptr<const Source>& source,
                                                         const std::string& type);
  std::shared_ptr<google::protobuf::Message> make(const std::string& type) const;
  /// The file and what it imports, dependencies before users.
  static google::protobuf::FileDescriptorSet files_of(const google::protobuf::FileDescriptor& file);
  /// Describes a service or object by its full name or the last part of it. Throws Error NotFound with near names.
  control::Description describe(const std::string& name) const;

 private:
  mutable std::shared_mutex mutex_;
  std::map<std::string, std::shared_ptr<const Source>> plugins_;
};

/// "fiona.localisation.LocationProvider" -> "LocationProvider".
std::string last_part(const std::string& full_name);

}  // namespace fiona::host
