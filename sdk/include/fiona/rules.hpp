#pragma once

#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "fiona/service.hpp"

namespace fiona {

/// The rules that an object's fields declare: range, length, finiteness, covariance (options.proto), enumerators.
/// Compiled once per type; checking costs a few nanoseconds per ruled field, and nothing where no field has a rule.
class ObjectRules {
 public:
  explicit ObjectRules(const google::protobuf::Descriptor& type);
  ObjectRules(const ObjectRules&) = delete;
  ObjectRules& operator=(const ObjectRules&) = delete;

  /// The first field that breaks a rule, as a sentence ("position.reference_lat is 95, above 90 deg"); none if all
  /// hold. An absent optional field and an empty list break none.
  std::optional<std::string> first_violation(const Object& object) const;

 private:
  using Number = double (*)(const google::protobuf::Reflection& reflect, const Object& object,
                            const google::protobuf::FieldDescriptor& field);
  struct FieldRule {
    bool allows(double value) const;
    std::string violation(double value, const std::string& name) const;

    const google::protobuf::FieldDescriptor* field;
    Number number = nullptr;  ///< of one that is not repeated
    bool repeated = false;    ///< with the next two asked for once: each costs as much as a number
    bool presence = false;
    bool enumeration = false;
    std::optional<double> min{};
    std::optional<double> max{};
    int size = 0;
    std::size_t max_size = 0;
    bool finite = false;
    bool covariance = false;
    const std::vector<FieldRule>* nested = nullptr;  ///< those of its fields
  };
  using Rules = std::vector<FieldRule>;

  const Rules& compile(const google::protobuf::Descriptor& type);
  std::optional<std::string> check(const Object& object, const Rules& rules) const;
  std::optional<std::string> check_field(const Object& object, const google::protobuf::Reflection& reflect,
                                         const FieldRule& rule) const;
  std::optional<std::string> check_nested(const Object& object, const google::protobuf::Reflection& reflect,
                                          const FieldRule& rule) const;

  std::unordered_map<const google::protobuf::Descriptor*, Rules> rules_;
  const Rules& root_;
};

}  // namespace fiona
