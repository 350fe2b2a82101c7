#include "model.hpp"

#include <fmt/format.h>

#include "fiona/contract.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/unicode.hpp"

namespace fiona::host {
namespace {

/// How long a change of mode may hold up those that wait behind it.
constexpr double kMostModeChange_ms = 3'600'000;

}  // namespace

void require_name(const std::string& name, std::string_view kind) {
  if (unicode::is_name(name) && name != kHostItself) return;
  throw Error(
      ErrorCode::Usage,
      {.what = fmt::format("'{}' is no name for {}", name, kind),
       .expected =
           "a letter, then letters (in Unicode's normal form C), digits, '-' and '_', at most 64 bytes; not 'host'"});
}

const Model::Instance* Model::find(const std::string& name) const {
  const auto found = instances_.find(name);
  return found == instances_.end() ? nullptr : found->second.get();
}

const Model::Instance& Model::instance(const std::string& name) const {
  if (const Instance* found = find(name)) return *found;
  throw Error(ErrorCode::NotFound,
              {.what = "there is no instance '" + name + "'", .next = "ls", .near = nearest_names(name, names())});
}

std::vector<std::string> Model::names() const {
  std::vector<std::string> all;
  for (const auto& [name, one] : instances_) all.push_back(name);
  return all;
}

std::vector<std::string> Model::names_in(const std::string& group) const {
  std::vector<std::string> all;
  for (const auto& [name, one] : instances_) {
    if (one->group == group) all.push_back(name);
  }
  return all;
}

const PortInterface& Model::port(const control::PortName& name, Direction direction) const {
  std::vector<std::string> fitting;
  for (const auto& one : instance(name.instance()).interface().ports()) {
    if (one.direction() != direction) {
      if (one.name() != name.port()) continue;
      throw Error(ErrorCode::Usage,
                  {.what = fmt::format("{} {} {}", text_of(name), one.direction() == PROVIDES ? "provides" : "requires",
                                       last_part(one.service())),
                   .expected = direction == PROVIDES ? "a port that provides" : "a port that requires",
                   .next = "show " + name.instance()});
    }
    if (one.name() == name.port()) return one;
    fitting.push_back(one.name());
  }
  throw Error(ErrorCode::NotFound, {.what = fmt::format("'{}' has no port '{}' that {}", name.instance(), name.port(),
                                                        direction == PROVIDES ? "provides" : "requires"),
                                    .expected = fitting.empty() ? "nothing: it has none"
                                                                : fmt::format("one of {}", fmt::join(fitting, ", ")),
                                    .next = "show " + name.instance(),
                                    .near = nearest_names(name.port(), fitting)});
}

void Model::make(const control::Change& change, const Packages& packages) {
  switch (change.what_case()) {
    case control::Change::kLoad: return load(change.load(), packages);
    case control::Change::kUnload: return unload(change.unload());
    case control::Change::kWire: return wire(change.wire());
    case control::Change::kUnwire: return unwire(change.unwire());
    case control::Change::kSet:
      return change.set().instance() == kHostItself ? set_host(change.set()) : set(change.set());
    case control::Change::kState: return state(change.state());
    case control::Change::kReplace:
      for (const auto& step : steps_of(change)) make(step, packages);
      return;
    case control::Change::kUpgrade: {
      const control::Upgrade& request = change.upgrade();
      const Instance& old = instance(request.instance());
      return upgrade(request.instance(), packages.find(old.source(), request.version()).package,
                     request.group().empty() ? old.group : request.group());
    }
    case control::Change::WHAT_NOT_SET: break;
  }
  throw Error(ErrorCode::Usage, {.what = "the change is empty, or newer than this host",
                                 .next = "fiona version: console and host are to be of one version"});
}

void Model::unload(const control::Unload& request) {
  instance(request.instance());
  require_own(request.instance(), true);
  std::erase_if(wires_, [&](const auto& entry) { return entry.first.first == request.instance(); });
  instances_.erase(request.instance());
}

void Model::set_host(const control::Set& request) {
  ClockSettings next = clock_.changed(request);
  if (next.is_another_than(clock_) && !instances_.empty()) {
    throw Error(ErrorCode::NotAllowed,
                {.what = fmt::format("{} instances live by the present clock", instances_.size()),
                 .next = "set host clock before the first load"});
  }
  clock_ = std::move(next);
}

/// Whether the component may go there, only its life cycle can tell.
void Model::state(const control::State& request) {
  require_own(request.instance());
  if (request.within_ms() > kMostModeChange_ms) {
    throw Error(ErrorCode::Usage, {.what = "the time for a change of mode is out of range",
                                   .where = request.instance(),
                                   .expected = "up to 1h",
                                   .found = fmt::format("{:g} ms", request.within_ms())});
  }
  auto draft = std::make_shared<Instance>(instance(request.instance()));
  draft->mode = request.mode() == kModeDeactivated ? std::string(kModeNeutral) : request.mode();
  instances_[request.instance()] = std::move(draft);
}

bool Model::Instance::is_in(std::string_view now) const {
  return now == mode || (now == kModeDeactivated && mode == kModeNeutral);
}

void Model::require_own(const std::string& name, bool to_unload) const {
  const Instance* found = find(name);
  if (!found || !found->led || (leader_.empty() && to_unload)) return;
  if (leader_.empty()) {
    throw Error(ErrorCode::NotAllowed,
                {.what = fmt::format("'{}' is of the system of a host that led this one and has gone", name),
                 .expected = "it is left as it is, or unloaded",
                 .next = "unload " + name});
  }
  throw Error(ErrorCode::NotAllowed,
              {.what = fmt::format("'{}' belongs to the system of host '{}', which leads this one", name, leader_),
               .next = fmt::format("say it on host '{}'", leader_)});
}

void Model::take(const std::string& name, Instance instance) {
  require_name(name, "an instance");
  if (const Instance* taken = find(name)) {
    throw Error(ErrorCode::Usage, {.what = "there is an instance '" + name + "' already",
                                   .found = taken->package->name,
                                   .next = "load PLUGIN as NAME, another one; or unload " + name});
  }
  instance.led = true;
  instance.order = next_order_++;
  instances_[name] = std::make_shared<const Instance>(std::move(instance));
}

}  // namespace fiona::host
