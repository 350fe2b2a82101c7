#include "fiona/service.hpp"

#include <google/protobuf/descriptor.h>

#include <algorithm>

#include "fiona/error.hpp"
#include "fiona/result.hpp"

namespace fiona {

std::string_view to_string(Outcome outcome) {
  switch (outcome) {
    case Outcome::Ok: return "ok";
    case Outcome::NoData: return "no_data";
    case Outcome::Timeout: return "timeout";
    case Outcome::Cancelled: return "cancelled";
    case Outcome::Disconnected: return "disconnected";
    case Outcome::Unwired: return "unwired";
    case Outcome::NotActive: return "not_active";
    case Outcome::WrongId: return "wrong_id";
    case Outcome::Rejected: return "rejected";
  }
  return "unknown";
}

std::string_view to_string(Pattern pattern) {
  switch (pattern) {
    case SEND: return "send";
    case QUERY: return "query";
    case PUSH_NEWEST: return "push newest";
    case PUSH_TIMED: return "push timed";
    case EVENT: return "event";
    default: return "no pattern";
  }
}

ServiceInfo::ServiceInfo(const google::protobuf::ServiceDescriptor& descriptor)
    : descriptor_(descriptor), contract_(descriptor.options().GetExtension(fiona::contract)) {
  const bool event = contract_.pattern() == EVENT;
  const auto* method = descriptor.FindMethodByName(contract_.pattern() == QUERY ? "Query" : event ? "Event" : "Object");
  if (!method || contract_.pattern() == PATTERN_UNSPECIFIED) {
    throw Error(ErrorCode::Usage,
                {.what = "service " + descriptor.full_name() + " declares no pattern that FIONA knows",
                 .where = descriptor.file()->name(),
                 .expected = "option (fiona.contract) with a pattern, and the rpc that the pattern asks for",
                 .next = "see proto/README.md, \"services\""});
  }
  const bool from_client = contract_.pattern() == SEND || contract_.pattern() == QUERY || event;
  object_ = from_client ? method->input_type() : method->output_type();
  if (contract_.pattern() == QUERY || event) answer_ = method->output_type();
}

Duration ServiceInfo::lease() const {
  using std::chrono::milliseconds;
  if (contract_.lease_ms() > 0) return milliseconds(contract_.lease_ms());
  if (contract_.period_ms() == 0) return Duration::zero();
  return std::max<Duration>(3 * period(), milliseconds(300));
}

}  // namespace fiona
