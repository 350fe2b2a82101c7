#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <google/protobuf/descriptor.h>
#include <google/protobuf/descriptor.pb.h>
#include <google/protobuf/dynamic_message.h>
#include <google/protobuf/message.h>
#include <nlohmann/json.hpp>

#include "table.hpp"

namespace fiona::console {

/// Types that came as descriptors, with which any object is read without compiled code.
class TypeSet {
 public:
  /// Files that a set lacks are taken from the platform's own. Throws fiona::Error (Failed) where they do not fit
  /// together.
  explicit TypeSet(const google::protobuf::FileDescriptorSet& files);

  /// By full name; nullptr where unknown. What the set does not have is looked for among the platform's types.
  const google::protobuf::Descriptor* object(const std::string& full_name) const;
  const google::protobuf::ServiceDescriptor* service(const std::string& full_name) const;

  /// An empty object of the type; nullptr where it is unknown.
  std::unique_ptr<google::protobuf::Message> make(const std::string& full_name) const;

 private:
  // The factory's prototypes point into the pool, so it goes first.
  std::unique_ptr<google::protobuf::DescriptorPool> pool_;
  std::unique_ptr<google::protobuf::DynamicMessageFactory> factory_;
};

/// One number or text inside an object: "position.x", "1.25", "m".
struct FieldText {
  std::string path;
  std::string text;
  std::string unit;
};

/// What becomes of fields that are marked `(fiona.secret)`.
enum class Secrets {
  Hidden,
  Shown,  ///< to somebody who has asked for nothing else
};

/// The fields that are set, in the order of their declaration, nested ones by path. With `wanted`, only those and what
/// is below them. Long lists end in "… n more" after `most_elements`. Of secrets it says that they are.
std::vector<FieldText> field_texts(const google::protobuf::Message& object, const std::vector<std::string>& wanted,
                                   Secrets secrets = Secrets::Hidden, int most_elements = 8);

/// Whether a path like "position.x" or "beacons[0].rssi" exists in the type; near names of the level that fails.
struct PathCheck {
  bool exists = false;
  std::string level;               ///< the type in which the name was not found
  std::vector<std::string> known;  ///< its fields
};
PathCheck check_path(const google::protobuf::Descriptor& type, std::string_view path);

/// Whether a value of a probe travels as the only field of this type, and not as an object of its own.
bool is_plain_value(std::string_view type);

/// The whole object for programs, names as in the proto; secrets are null.
nlohmann::json object_json(const google::protobuf::Message& object, Secrets secrets = Secrets::Hidden);

/// Fields with type, unit, range and doc, nested ones by path.
Table field_table(const google::protobuf::Descriptor& type);

/// "push newest", "query".
std::string pattern_text(int pattern);

}  // namespace fiona::console
