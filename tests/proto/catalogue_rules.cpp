#include <set>

#include "catalogue.hpp"
#include "fiona/options.pb.h"

namespace fiona::catalogue {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::DescriptorPool;
using google::protobuf::FieldDescriptor;
using google::protobuf::FileDescriptor;
using google::protobuf::ServiceDescriptor;

using Differences = std::vector<std::string>;

const std::set<std::string>& frames() {
  static const std::set<std::string> names = {"enu", "ecef", "wgs84", "device", "magnetic", "true_north"};
  return names;
}

bool is_number(const FieldDescriptor& field) {
  const auto type = field.cpp_type();
  return type != FieldDescriptor::CPPTYPE_BOOL && type != FieldDescriptor::CPPTYPE_ENUM &&
         type != FieldDescriptor::CPPTYPE_STRING && type != FieldDescriptor::CPPTYPE_MESSAGE;
}

bool is_bounded(const FieldDescriptor& field) {
  const bool needs_bound = field.is_repeated() || field.cpp_type() == FieldDescriptor::CPPTYPE_STRING;
  const auto& options = field.options();
  return !needs_bound || options.GetExtension(fiona::size) > 0 || options.GetExtension(fiona::max_size) > 0;
}

// What nobody filled must pass the hull: a sender that says "not valid" and no more is not refused for it.
bool default_is_in_range(const FieldDescriptor& field) {
  const auto& options = field.options();
  if (field.has_presence() || field.is_repeated()) return true;
  return (!options.HasExtension(fiona::min) || options.GetExtension(fiona::min) <= 0) &&
         (!options.HasExtension(fiona::max) || options.GetExtension(fiona::max) >= 0);
}

void check_field(const FieldDescriptor& field, const std::set<std::string>& dimensionless, Differences& out) {
  const auto& options = field.options();
  const std::string& name = field.full_name();
  if (options.GetExtension(fiona::doc).empty()) out.push_back(name + " has no doc");
  const bool wants_unit = is_number(field) && dimensionless.count(name) == 0;
  if (wants_unit == options.GetExtension(fiona::unit).empty()) {
    out.push_back(name + (wants_unit ? " is a number without a unit"
                                     : " has a unit and is no number, or is listed "
                                       "as dimensionless"));
  }
  const std::string& frame = options.GetExtension(fiona::frame);
  if (!frame.empty() && frames().count(frame) == 0) out.push_back(name + " has the unknown frame \"" + frame + '"');
  // Who plays a recording moves the times in it, and finds them by this.
  const bool is_time = field.type() == FieldDescriptor::TYPE_INT64 && options.GetExtension(fiona::unit) == "ms";
  if (is_time != (options.GetExtension(fiona::doc).find("since 1970-01-01 UTC") != std::string::npos))
    out.push_back(name + " is a time, int64 with the unit ms, in its doc or in its type, and not in both");
  if (!default_is_in_range(field)) out.push_back(name + " is refused when nobody sets it: 0 is out of its range");
  const bool says_covariance =
      field.is_repeated() && options.GetExtension(fiona::doc).find("covariance") != std::string::npos;
  if (says_covariance != options.GetExtension(fiona::covariance))
    out.push_back(name + " is a covariance in its doc or in its rule, and not in both");
  if (!is_bounded(field)) out.push_back(name + " may grow without bound: no size, no max_size");
  if (options.HasExtension(fiona::min) && options.HasExtension(fiona::max) &&
      options.GetExtension(fiona::min) >= options.GetExtension(fiona::max)) {
    out.push_back(name + " has an empty range");
  }
}

void check_service(const ServiceDescriptor& service, Differences& out) {
  const fiona::ServiceContract& contract = service.options().GetExtension(fiona::contract);
  const bool push = contract.pattern() == fiona::PUSH_NEWEST || contract.pattern() == fiona::PUSH_TIMED;
  const std::string& name = service.full_name();
  if (service.options().GetExtension(fiona::service_doc).empty()) out.push_back(name + " has no service_doc");
  if (contract.major() != 1) out.push_back(name + " has no major version 1");
  if ((contract.pattern() == fiona::PUSH_TIMED) != (contract.period_ms() > 0)) {
    out.push_back(name + ": a period is for push timed, and push timed has one");
  }
  if (contract.pattern() == fiona::PUSH_NEWEST && contract.lease_ms() == 0) {
    out.push_back(name + " is push newest without a lease: it has no period to derive one from");
  }
  if (!push && (contract.last_value() || contract.lease_ms() > 0))
    out.push_back(name + ": last value and lease are for push");
  if (contract.idempotent() && contract.pattern() != fiona::QUERY) out.push_back(name + ": idempotent is for query");
}

void check_uncertainty(const Descriptor& message, Differences& out) {
  if (!all_added(message) && !has_comment(message, "Uncertainty:")) {
    out.push_back(message.full_name() + " does not say where its uncertainty is carried");
  }
}

}  // namespace

bool is_added(const FieldDescriptor& field) { return field.options().GetExtension(fiona::document_type) == "added"; }

bool all_added(const Descriptor& message) {
  for (int i = 0; i < message.field_count(); ++i) {
    if (!is_added(*message.field(i))) return false;
  }
  return true;
}

Differences check_rules(const DescriptorPool& pool, const std::vector<std::string>& dimensionless) {
  const std::set<std::string> without_unit(dimensionless.begin(), dimensionless.end());
  Differences out;
  for (const std::string& area : areas()) {
    const FileDescriptor* file = pool.FindFileByName("fiona/" + area + ".proto");
    if (!file) {
      out.push_back("fiona/" + area + ".proto does not exist");
      continue;
    }
    for (int i = 0; i < file->message_type_count(); ++i) {
      const Descriptor& message = *file->message_type(i);
      for (int j = 0; j < message.field_count(); ++j) check_field(*message.field(j), without_unit, out);
      if (area == "sensors" || area == "perception") check_uncertainty(message, out);
    }
    for (int i = 0; i < file->service_count(); ++i) check_service(*file->service(i), out);
  }
  return out;
}

}  // namespace fiona::catalogue
