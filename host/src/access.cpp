#include "access.hpp"

#include <algorithm>

#include "fiona/error.hpp"
#include "fiona/marketplace/manifest.hpp"
#include "names.hpp"

namespace fiona::host {
namespace {

using control::Change;
using control::Request;
using trust::Access;

// Neither switch has a default: a kind without a level does not compile.

/// A path names any file on this machine, where a package is what its user has installed.
bool names_a_library(const control::Load& load) { return !marketplace::library_path(load.plugin()).empty(); }

/// What opens files, devices or everything to a package.
std::optional<std::string> right_beyond_a_sandbox(const control::Load& load) {
  const auto found = std::find_if(load.rights().begin(), load.rights().end(), [](const std::string& right) {
    return right == kUnconfined || (marketplace::opens_sandbox(right) && right != "network");
  });
  return found == load.rights().end() ? std::nullopt : std::optional(*found);
}

bool names_a_file(const control::Set& set) {
  const auto& parameters = set.parameters();
  return set.instance() == kHostItself &&
         std::any_of(parameters.begin(), parameters.end(), [](const auto& one) { return one.name() == "deliveries"; });
}

Need need_of(const Change& change) {
  switch (change.what_case()) {
    case Change::kLoad:
      if (names_a_library(change.load())) return {Access::Administer, "load of a path"};
      if (const auto right = right_beyond_a_sandbox(change.load())) return {Access::Administer, "load with " + *right};
      return {Access::Compose, "load"};
    case Change::kUnload: return {Access::Compose, "unload"};
    case Change::kWire: return {Access::Compose, "wire"};
    case Change::kUnwire: return {Access::Compose, "unwire"};
    case Change::kReplace: return {Access::Compose, "swap"};
    case Change::kUpgrade: return {Access::Compose, "upgrade"};
    case Change::kSet:
      if (names_a_file(change.set())) return {Access::Administer, "set host deliveries"};
      return {Access::Operate, "set"};
    case Change::kState: return {Access::Operate, "state"};
    case Change::WHAT_NOT_SET: break;
  }
  return {Access::Nobody, "a change that this host does not know"};
}

}  // namespace

Need need_of(const control::Transact& transact) {
  Need most{Access::Observe, "plan"};
  for (const auto& change : transact.changes()) {
    Need need = need_of(change);
    // To try is to look; but not at files, and at nothing unknown.
    if (transact.dry_run() && need.level < Access::Administer) continue;
    if (need.level > most.level) most = std::move(need);
  }
  if (!transact.whole() || transact.dry_run() || most.level >= Access::Compose) return most;
  return {Access::Compose, "apply"};
}

Need need_of(const Request& request) {
  switch (request.what_case()) {
    case Request::kTransact: return need_of(request.transact());
    case Request::kUndo: return {request.undo().dry_run() ? Access::Observe : Access::Compose, "undo"};
    case Request::kJournal: return {Access::Observe, "journal"};
    case Request::kSnapshot: return {Access::Observe, "to look at the system"};
    case Request::kDescribe: return {Access::Observe, "show"};
    case Request::kWatch: return {Access::Observe, "watch"};
    case Request::kUnwatch: return {Access::Observe, "watch stop"};
    case Request::kNext: return {Access::Observe, "watch"};
    case Request::kRead: return {Access::Observe, "show"};
    case Request::kWaitMode: return {Access::Observe, "wait"};
    case Request::kExpect: return {Access::Observe, "expect"};
    case Request::kSleep: return {Access::Observe, "sleep"};
    case Request::kRun: return {Access::Operate, "run"};
    case Request::kCall: return {Access::Operate, "call"};
    case Request::kAttach: return {Access::Compose, "attach"};
    case Request::kDetach: return {Access::Compose, "detach"};
    case Request::kQuit: return {Access::Administer, "quit"};
    case Request::kUpgradeHost: return {Access::Administer, "upgrade host"};
    case Request::WHAT_NOT_SET: break;
  }
  return {Access::Nobody, "a request that is empty or newer than this host"};
}

void require(const Rights& rights, const Request& request) { require(rights, need_of(request)); }

void require(const Rights& rights, const Need& need) {
  if (rights.level >= need.level) return;
  const std::string who = rights.name.empty() || rights.is_remote() ? "this console" : "'" + rights.name + "'";
  std::string next = need.level > Access::Administer ? "fiona version" : "a console on the machine of the host may";
  if (need.level <= rights.of_key) {
    next = "the same with --control: fiona --at HOST --control LINE";
  } else if (need.level <= Access::Administer && rights.is_remote()) {
    next = "on the machine of the host: fiona keys allow " + rights.name + " " + rights.key + " as " +
           trust::access_name(need.level);
  }
  throw Error(
      ErrorCode::NotAllowed,
      {.what = need.level > Access::Administer ? need.what + " is for nobody"
                                               : need.what + " needs the level " + access_text(need.level) + ", and " +
                                                     who + " has " + access_text(rights.level),
       .expected = need.level > Access::Administer ? "" : access_text(need.level),
       .found = access_text(rights.level) +
                (rights.level < rights.of_key ? ", of " + access_text(rights.of_key) + " that its key may have" : ""),
       .next = next});
}

}  // namespace fiona::host
