#include "schema.hpp"

#include <google/protobuf/descriptor.pb.h>

#include <algorithm>
#include <map>
#include <set>

#include "fiona/contract.hpp"

namespace fiona::recording_player {
namespace {

namespace pb = google::protobuf;

/// Files that import each other in a row cost the stack.
constexpr int kMostFiles = 1000;

struct FirstProblem final : pb::DescriptorPool::ErrorCollector {
  void AddError(const std::string&, const std::string& element, const pb::Message*, ErrorLocation,
                const std::string& message) override {
    if (text.empty()) text = element + ": " + message;
  }
  std::string text;
};

/// Builds a file behind those that it needs. False: one of them does not fit, or is not there.
bool build(const std::string& name, const std::map<std::string, const pb::FileDescriptorProto*>& files,
           std::set<std::string>& begun, pb::DescriptorPool& pool, FirstProblem& problem) {
  if (!begun.insert(name).second) return true;
  const auto file = files.find(name);
  if (file == files.end()) {
    problem.text = "a file that is imported is missing";
    return false;
  }
  for (const std::string& needed : file->second->dependency()) {
    if (!build(needed, files, begun, pool, problem)) return false;
  }
  return pool.BuildFileCollectingErrors(*file->second, &problem) != nullptr;
}

}  // namespace

std::optional<std::string> difference(const McapReader::Channel& channel, const pb::Descriptor& type) {
  if (channel.encoding != "protobuf")
    return "its messages are encoded as '" + channel.encoding + "', not as 'protobuf'";
  if (channel.schema_encoding != "protobuf")
    return "its type is described as '" + channel.schema_encoding + "', not as 'protobuf'";
  pb::FileDescriptorSet set;
  if (!set.ParseFromString(channel.schema)) return "the description of its type is garbled";
  if (set.file_size() > kMostFiles) return "the description of its type has more than 1000 files";
  std::map<std::string, const pb::FileDescriptorProto*> files;
  for (const auto& file : set.file()) files.emplace(file.name(), &file);
  pb::DescriptorPool pool;
  FirstProblem problem;
  std::set<std::string> begun;
  const bool fits = std::all_of(set.file().begin(), set.file().end(),
                                [&](const auto& file) { return build(file.name(), files, begun, pool, problem); });
  if (!fits) return "the description of its type does not fit together: " + problem.text;
  const auto* recorded = pool.FindMessageTypeByName(channel.type);
  if (!recorded) return "the description of its type does not have it";
  return object_difference(type, *recorded);
}

}  // namespace fiona::recording_player
