#include "types.hpp"

#include <functional>
#include <mutex>
#include <set>

#include "fiona/error.hpp"
#include "fiona/hmi.pb.h"
#include "fiona/localisation.pb.h"
#include "fiona/navigation.pb.h"
#include "fiona/options.pb.h"
#include "fiona/perception.pb.h"
#include "fiona/security.pb.h"
#include "fiona/sensors.pb.h"

namespace fiona::host {

using google::protobuf::Descriptor;
using google::protobuf::DescriptorPool;
using google::protobuf::FileDescriptor;
using google::protobuf::ServiceDescriptor;

/// A plugin's protos, on top of the platform's, in a pool of their own: two versions of a file can be known at once.
class Types::Source {
 public:
  std::string content;  ///< the descriptors, serialised: tells builds apart
  DescriptorPool pool{DescriptorPool::generated_pool()};
  std::vector<const FileDescriptor*> files;
  mutable google::protobuf::DynamicMessageFactory factory;
};

namespace {

std::vector<const FileDescriptor*> catalogue() {
  return {sensors::GetIMU::descriptor()->file(),
          perception::CommObstacle::descriptor()->file(),
          localisation::CommLocation::descriptor()->file(),
          navigation::CommPath::descriptor()->file(),
          security::CommAuthenticationRequest::descriptor()->file(),
          hmi::NextTurn::descriptor()->file()};
}

bool is_same(const FileDescriptor& built, const google::protobuf::FileDescriptorProto& file) {
  google::protobuf::FileDescriptorProto own;
  built.CopyTo(&own);
  return own.SerializeAsString() == file.SerializeAsString();
}

void add_with_imports(const FileDescriptor& file, std::set<std::string>& seen,
                      google::protobuf::FileDescriptorSet& set) {
  if (!seen.insert(file.name()).second) return;
  for (int i = 0; i < file.dependency_count(); ++i) add_with_imports(*file.dependency(i), seen, set);
  file.CopyTo(set.add_file());
}

}  // namespace

Types::Types() = default;
Types::~Types() = default;

std::shared_ptr<const Types::Source> Types::read(const std::string& plugin, const Interface& interface) {
  auto source = std::make_shared<Source>();
  source->content = interface.descriptors().SerializeAsString();
  for (const auto& file : interface.descriptors().file()) {
    // Libraries of this process may have brought the file, or another one of the same name.
    const FileDescriptor* built = source->pool.FindFileByName(file.name());
    if (!built || !is_same(*built, file)) built = source->pool.BuildFile(file);
    if (!built) {
      throw Error(ErrorCode::Failed,
                  {.what = "the interface of plugin '" + plugin + "' has a proto that does not fit: " + file.name(),
                   .next = "install the package again, or ask the publisher to pack it again"});
    }
    source->files.push_back(built);
  }
  return source;
}

void Types::add(const std::string& plugin, std::shared_ptr<const Source> source) {
  const std::unique_lock lock(mutex_);
  auto& known = plugins_[plugin];
  if (known && known->content == source->content) return;
  known = std::move(source);
}

const ServiceDescriptor* Types::service(const Source& source, const std::string& full_name) {
  return source.pool.FindServiceByName(full_name);
}

std::shared_ptr<google::protobuf::Message> Types::make(const std::shared_ptr<const Source>& source,
                                                       const std::string& type) {
  const auto* known = source->pool.FindMessageTypeByName(type);
  if (!known) return nullptr;
  return {source->factory.GetPrototype(known)->New(), [source](google::protobuf::Message* made) { delete made; }};
}

std::shared_ptr<google::protobuf::Message> Types::make(const std::string& type) const {
  if (const auto* known = DescriptorPool::generated_pool()->FindMessageTypeByName(type)) {
    return std::shared_ptr<google::protobuf::Message>(
        google::protobuf::MessageFactory::generated_factory()->GetPrototype(known)->New());
  }
  const std::shared_lock lock(mutex_);
  for (const auto& [plugin, source] : plugins_) {
    if (auto made = make(source, type)) return made;
  }
  return nullptr;
}

google::protobuf::FileDescriptorSet Types::files_of(const FileDescriptor& file) {
  std::set<std::string> seen;
  google::protobuf::FileDescriptorSet set;
  add_with_imports(file, seen, set);
  return set;
}

control::Description Types::describe(const std::string& name) const {
  const std::shared_lock lock(mutex_);
  std::vector<const FileDescriptor*> files = catalogue();
  for (const auto& [plugin, source] : plugins_) files.insert(files.end(), source->files.begin(), source->files.end());
  std::vector<std::string> known;
  const auto matches = [&](const std::string& full_name) {
    known.push_back(last_part(full_name));
    return full_name == name || known.back() == name;
  };
  control::Description description;
  for (const FileDescriptor* file : files) {
    for (int i = 0; i < file->service_count(); ++i) {
      if (!matches(file->service(i)->full_name())) continue;
      description.set_name(file->service(i)->full_name());
      description.set_is_service(true);
      *description.mutable_contract() = file->service(i)->options().GetExtension(fiona::contract);
      *description.mutable_files() = files_of(*file);
      return description;
    }
    for (int i = 0; i < file->message_type_count(); ++i) {
      if (!matches(file->message_type(i)->full_name())) continue;
      description.set_name(file->message_type(i)->full_name());
      *description.mutable_files() = files_of(*file);
      return description;
    }
  }
  throw Error(ErrorCode::NotFound, {.what = "there is no service or object '" + name + "'",
                                    .next = "ls services",
                                    .near = nearest_names(name, known)});
}

std::string last_part(const std::string& full_name) { return full_name.substr(full_name.rfind('.') + 1); }

}  // namespace fiona::host
