#include "remote_group.hpp"

#include "fiona/error.hpp"

namespace fiona::host {
namespace {

/// As of a child group, and a second for the way.
constexpr std::chrono::seconds kRemoteDeadline{13};

}  // namespace

void RemoteGroup::tell(wire::GroupRequest request) {
  try {
    perform(request);
  } catch (const Error&) {
    if (end_.empty() && !alive()) owe(std::move(request));
  }
}

wire::GroupMessage RemoteGroup::perform(const wire::GroupRequest& request) {
  if (end_.empty()) return peer_.request(group_, request, kRemoteDeadline);
  throw Error(ErrorCode::Unreachable, {.what = "group '" + name() + "' does not answer", .found = end_, .next = "ls hosts"});
}

}  // namespace fiona::host
