#pragma once

#include <google/protobuf/descriptor.h>

#include <cstddef>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::catalogue {

/// One attribute of the source document: section 3.1 (23 services) or figure 2, as `catalogue.csv` holds it.
/// Names, types and units are the document's letters; descriptions are shortened.
struct Row {
  std::size_t line = 0;
  std::string area;     ///< file and package: "sensors" is fiona/sensors.proto, package fiona.sensors
  std::string service;  ///< empty for figure 2
  std::string pattern;
  std::string role;  ///< object, request, answer, nested, figure
  std::string object;
  std::string attribute;
  std::string type;
  std::string unit;
  std::string description;
  /// Where the proto may differ, "key=value; key=value": `type`, `unit` (what it has instead), `fields` (the
  /// fields that stand for one attribute), or the word `meaning` (only the meaning was decided). Each needs a
  /// comment.
  std::map<std::string, std::string> decision;
};

/// Reads the table. Throws std::runtime_error that names file, line and column where it is malformed.
std::vector<Row> read_table(const std::string& path);

/// The six files of the catalogue.
const std::vector<std::string>& areas();

/// Every difference between the table and the protos, one sentence each; none if they agree.
/// `pool` must hold source info, since a decision counts only where a comment documents it.
std::vector<std::string> compare(const std::vector<Row>& rows, const google::protobuf::DescriptorPool& pool);

/// What every field and service of the catalogue must have, whatever the table says: doc, unit, frame of the
/// list, bounds. `dimensionless` are the full names of the numbers without a unit.
std::vector<std::string> check_rules(const google::protobuf::DescriptorPool& pool,
                                     const std::vector<std::string>& dimensionless);

/// Whether the document does not have this field, or any field of this message.
bool is_added(const google::protobuf::FieldDescriptor& field);
bool all_added(const google::protobuf::Descriptor& message);

/// Whether a comment with this text stands before the declaration in the proto.
template <typename AnyDescriptor>
bool has_comment(const AnyDescriptor& descriptor, const std::string& text = "") {
  google::protobuf::SourceLocation location;
  return descriptor.GetSourceLocation(&location) && !location.leading_comments.empty() &&
         location.leading_comments.find(text) != std::string::npos;
}

}  // namespace fiona::catalogue
