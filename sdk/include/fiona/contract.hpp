#pragma once

#include <google/protobuf/descriptor.h>

#include <optional>
#include <string>

namespace fiona {

/// Why a port that requires `required` cannot use a port that provides `provided`; none if it can. The services may
/// come from different descriptor pools: two processes, or two versions of a package.
///
/// They fit when the full names are equal, the major versions are equal and the provider's minor is not below the
/// client's, and every object agrees field by field: number, declared type, cardinality, enumerators, units, frames
/// and array lengths (docs/architecture.md, The way of a message). The sentence names the first field that differs.
std::optional<std::string> contract_difference(const google::protobuf::ServiceDescriptor& required,
                                               const google::protobuf::ServiceDescriptor& provided);
/// The same of two objects of one name.
std::optional<std::string> object_difference(const google::protobuf::Descriptor& required,
                                             const google::protobuf::Descriptor& provided);

}  // namespace fiona
