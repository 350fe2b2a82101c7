// Another version of an instance takes its place while it runs: made beside it, checked, given its wires; and the one
// before stands by for a while, to take its place again.
#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "failure.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/params.hpp"
#include "fiona/readable_text.hpp"
#include "fiona/service.hpp"
#include "system.hpp"

namespace fiona::host {
namespace {

/// One that stands by is asked once, and may be busy for as long as it may be watched.
constexpr double kRestsWithin_ms = 3'600'000;
/// A process that is silent at its version's end is ended then at the latest; what watches it does so before.
constexpr std::chrono::seconds kMostDestroyed{26};

std::string version_text(const Model::Instance& one) {
  return fmt::format("{} {}", one.package->name, one.package->version);
}

const google::protobuf::ServiceDescriptor* service_of(const Model::Instance& one, const std::string& port) {
  for (const auto& declared : one.interface().ports()) {
    if (declared.name() == port) return Types::service(*one.package->types, declared.service());
  }
  return nullptr;
}

/// A send does something where it arrives: only one of two versions may.
bool sends(const Model::Instance& one, const std::string& port) {
  const auto* service = service_of(one, port);
  return service && ServiceInfo(*service).pattern() == SEND;
}

/// In which a port says something that says anything at all.
double patience_with_ms(const Model::Instance& one, const std::string& port) {
  const auto* service = service_of(one, port);
  const double period_ms = service ? ServiceInfo(*service).contract().period_ms() : 0;
  return std::clamp(3 * period_ms, kDelivers_ms, kMostDelivers_ms);
}

/// Not each message: only whether there are any.
control::Watch sampled(const std::string& name, const std::string& port) {
  control::Watch watch;
  *watch.mutable_port() = port_of({name, port});
  watch.set_min_period_ms(20);
  return watch;
}

/// Of a version that does not do what the one before did.
Error unfit(ErrorCode code, std::string why) { return {code, {.what = std::move(why), .next = "tell the publisher"}}; }

/// The push ports of an instance that others hear.
std::vector<std::string> heard_ports(const Model& model, const std::string& name) {
  std::set<std::string> ports;
  for (const auto& [client, wire] : model.wires()) {
    if (client.first == name) continue;
    for (const auto& provider : wire.providers) {
      if (provider.instance() == name) ports.insert(provider.port());
    }
  }
  std::erase_if(ports, [&](const std::string& port) {
    const auto* service = service_of(model.instance(name), port);
    return !service || !ServiceInfo(*service).is_push();
  });
  return {ports.begin(), ports.end()};
}

/// An entry that its map does not have for as long as this lives.
template <class Map>
class Without {
 public:
  Without(Map& map, const std::string& key) : map_(map), taken_(map.extract(key)) {}
  ~Without() {
    if (taken_) map_.insert(std::move(taken_));
  }
  Without(const Without&) = delete;
  Without& operator=(const Without&) = delete;
  bool was_there() const { return static_cast<bool>(taken_); }
  /// It does not come back.
  void forget() { taken_ = {}; }

 private:
  Map& map_;
  typename Map::node_type taken_;
};

std::optional<control::Reply> reply_of(Deliveries& check, const wire::GroupMessage& event) {
  std::optional<control::Reply> reply;
  const auto why = check.note(event);
  if (why) *reply.emplace().mutable_failure() = failure_of(unfit(ErrorCode::ComponentFailed, *why));
  return reply;
}

}  // namespace

/// Everything that can be told without starting it.
control::Upgrade System::completed(control::Upgrade request) const {
  const std::string& name = request.instance();
  const Model::Instance& old = model_.instance(name);
  model_.require_own(name);
  const auto reload = fmt::format("unload {}, then load it again", name);
  if (virtual_time_)
    throw Error(ErrorCode::NotAllowed,
                {.what = "on a virtual clock no two versions run beside each other", .next = reload});
  if (!host_of(old.group).empty()) {
    throw Error(ErrorCode::NotAllowed,
                {.what = fmt::format("'{}' is on host '{}', and is upgraded there only anew", name, host_of(old.group)),
                 .next = reload});
  }
  if ((supervision_.waits(old.group) && lost_in(old.group).contains(old.order)) || is_being_made(name))
    throw Error(ErrorCode::Unreachable,
                {.what = fmt::format("'{}' is being started again", name), .next = "wait for it"});
  if (!request.has_watch_ms()) request.set_watch_ms(kUpgradeWatch_ms);
  if (request.watch_ms() < 0 || request.watch_ms() > kMostUpgradeWatch_ms) {
    throw Error(ErrorCode::Usage, {.what = "the time to watch is out of range",
                                   .where = name,
                                   .expected = "0s .. 1h",
                                   .found = fmt::format("{:g} ms", request.watch_ms())});
  }
  const auto standby = standbys_.find(name);
  if (standby != standbys_.end() && request.version() == standby->second.made.package->version) {
    request.set_group(standby->second.made.group);
    return request;
  }
  const auto found = packages_.find(old.source(), request.version()).package;
  if (!request.version().empty() && found->version != request.version()) {
    throw Error(ErrorCode::NotFound,
                {.what = fmt::format("{} {} is not installed any more", found->name, request.version()),
                 .found = found->version,
                 .next = fmt::format("market install {}@{}", found->name, request.version())});
  }
  if (found == old.package) {
    throw Error(ErrorCode::Usage,
                {.what = fmt::format("'{}' runs what is installed already: {}", name, version_text(old)),
                 .next = old.package->installed() ? "market update " + found->name : "build it anew"});
  }
  request.set_version(found->version);
  request.set_group(fresh_group(name));
  return request;
}

/// Named after the instance; a number follows where that is taken.
std::string System::fresh_group(const std::string& instance) const {
  const auto taken = [this](const std::string& name) {
    return groups_.find(name) || !model_.names_in(name).empty() || name == kMainGroup || !host_of(name).empty();
  };
  std::string name = instance;
  for (int number = 2; taken(name); ++number) name = fmt::format("{}-{}", readable_text(instance, 50), number);
  return name;
}

bool System::stands_by(const std::string& name) const { return standbys_.contains(name); }

/// The model with this version in the place of the one that serves.
Model System::upgraded(const Beside& version) const {
  Model next = model_;
  next.upgrade(version.name, version.made.package, version.made.group);
  return next;
}

void System::begin_upgrade(const control::Upgrade& request, Waits::Answer answer) {
  const std::string& name = request.instance();
  const auto standby = standbys_.find(name);
  if (standby != standbys_.end() && standby->second.made.group == request.group()) return wake(name, std::move(answer));
  candidate_ = Beside{.name = name, .made = model_.instance(name)};
  candidate_->made.package = packages_.find(candidate_->made.source(), request.version()).package;
  candidate_->made.group = request.group();
  const Model next = upgraded(*candidate_);
  const Model::Instance& made = next.instance(name);
  control::Load load = next.load_of(name);
  load.set_mode(made.mode);
  bring_up(group(made.group, &made), name, made, load, std::move(answer), kUpgradeStart_ms);
}

/// It has stood by: what has been changed meanwhile is changed in it, too.
void System::wake(const std::string& name, Waits::Answer answer) {
  candidate_ = std::move(standbys_.extract(name).mapped());
  candidate_->is_back = true;
  candidate_->rests_at.reset();
  cut_beside(*candidate_);
  const Model next = upgraded(*candidate_);
  const Model::Instance& wanted = next.instance(name);
  Group& at = candidate_group();
  if (wanted.parameters) {
    wire::GroupRequest set;
    set.mutable_set_parameters()->set_instance(name);
    for (auto& one : differences(*wanted.parameters, *candidate_->made.parameters))
      *set.mutable_set_parameters()->add_parameters() = std::move(one);
    if (set.set_parameters().parameters_size() > 0) at.request(std::move(set));
  }
  candidate_->made = wanted;
  const std::uint64_t change = next_work_++;
  const auto begin = [&] { at.request(mode_request(name, wanted.mode, change)); };
  waits_->work(kNobody, change, kDelivers_ms, begin, end_of_mode(change),
               failure_reply(ErrorCode::Unreachable, {.what = "it did not come back from its rest"}),
               std::move(answer));
}

/// It is in its mode: it hears what the other one hears, and must say what the other one says.
void System::check_upgrade(Waits::Answer answer) {
  const std::string name = candidate_->name;
  made_known(candidate_->made.group, name);
  const Model next = upgraded(*candidate_);
  wire_candidate(next, false);
  std::vector<Deliveries::Pair> pairs;
  double longest_ms = kDelivers_ms;
  for (const std::string& port : candidate_->is_back ? std::vector<std::string>() : heard_ports(model_, name)) {
    pairs.push_back({port, new_tap(), new_tap()});
    longest_ms = std::max(longest_ms, patience_with_ms(candidate_->made, port));
  }
  const auto check = std::make_shared<Deliveries>(beside_name(name), pairs);
  const auto begin = [&] {
    for (const auto& pair : pairs) {
      candidate_->taps.insert(candidate_->taps.end(), {pair.tap, pair.before});
      taps_.open(candidate_group(), pair.tap, sampled(name, pair.port), true);
      // One that is gone says nothing, and nothing is expected then.
      if (!lost_.contains(name)) taps_.open(group_of(name, model_), pair.before, sampled(name, pair.port), true);
    }
  };
  const auto end_of = [check](const wire::GroupMessage& event) {
    std::optional<control::Reply> reply = reply_of(*check, event);
    if (!reply && check->all()) reply.emplace().mutable_done();
    return reply;
  };
  listen_to(check, pairs.empty() ? 0 : longest_ms, begin, end_of, std::move(answer));
}

/// Answered with Done once the end is told or the time is over and nothing is missing; else with why not.
void System::listen_to(const std::shared_ptr<Deliveries>& check, double within_ms, const std::function<void()>& begin,
                       Waits::EndOf end_of, Waits::Answer answer) {
  control::Reply over;
  over.mutable_done();
  const auto ended = [check, answer = std::move(answer)](control::Reply reply) {
    const auto missing = reply.has_done() ? check->missing() : std::nullopt;
    if (missing) *reply.mutable_failure() = failure_of(unfit(ErrorCode::Failed, *missing));
    answer(std::move(reply));
  };
  if (within_ms == 0) return ended(over);
  waits_->work(kNobody, next_work_++, within_ms, begin, std::move(end_of), over, ended);
}

Group& System::candidate_group() {
  if (Group* at = groups_.living(candidate_->made.group)) return *at;
  const ChildGroup* child = groups_.child(candidate_->made.group);
  throw unfit(ErrorCode::ComponentFailed, "its process " + (child ? child->end() : std::string("has ended")));
}

/// Opens what the candidate requires and has not yet. What it sends it sends only once it serves.
void System::wire_candidate(const Model& next, bool sends_too) {
  const std::string& name = candidate_->name;
  candidate_group();
  const Without of_the_one_that_serves(lost_, name);
  for (auto& [client, wire] : candidate_->wires) {  // its provider has been started again meanwhile
    if (wire.id != 0 && !wire.reason.empty()) wire = open_for_candidate(port_of(client), wire.provider, next, wire.id);
  }
  for (const auto& [client, wanted] : next.wires()) {
    if (client.first != name || candidate_->wires.contains(client)) continue;
    if (!sends_too && sends(next.instance(name), client.second)) continue;
    if (wanted.providers.size() > 1) arrange(port_of(client), wanted.providers, wanted.hold_ms, {}, next, nullptr);
    for (const auto& provider : wanted.providers)
      candidate_->wires.emplace(client, open_for_candidate(port_of(client), provider, next));
  }
}

/// As with the one that serves: one that does not open waits.
System::Wire System::open_for_candidate(const control::PortName& client, const control::PortName& provider,
                                        const Model& next, std::uint64_t replaces) {
  Wire waiting{provider, 0, false, "there is no instance '" + provider.instance() + "' yet", {}};
  try {
    control::Done ignored;
    if (next.find(provider.instance())) return connector_.connect(client, provider, next, replaces, ignored);
  } catch (const Error& error) {
    waiting.waits_for(error);
  }
  return waiting;
}

control::Done System::take_over(bool keeps) {
  untap_candidate();
  const std::string name = candidate_->name;
  const Model next = upgraded(*candidate_);
  const Model::Instance old = model_.instance(name);
  const Model::Instance& made = next.instance(name);
  const std::string process = candidate_group().endpoint();
  Without lost(lost_, name);
  control::Done done;
  switch_clients(name, next, done);
  try {
    // Those of the one go before those of the other come, so that nothing is done twice.
    for (const auto& [client, wire] : wires_) {
      if (client.first == name && sends(old, client.second))
        connector_.disconnect(port_of(client), wire, "another version serves");
    }
    wire_candidate(next, true);
    if (candidate_group().endpoint() != process) throw unfit(ErrorCode::ComponentFailed, "its process has ended");
  } catch (...) {
    switch_back(name);
    throw;
  }
  const bool has_just_ended = lost_.erase(name) > 0;  // and took those wires along that are the new one's by now
  for (auto& [client, wire] : wires_) {
    const bool uses_it = client.first != name && wire.provider.instance() == name && !lost_.contains(client.first);
    if (has_just_ended && uses_it) wire.reason.clear();
  }
  hand_over(next, old, keeps && !has_just_ended && !lost.was_there());
  lost.forget();
  done.set_note(fmt::format("{} in place of {}{}", version_text(made), old.package->version,
                            made.group == kMainGroup ? "" : ", in " + made.group));
  return done;
}

/// All who use it, or nobody.
void System::switch_clients(const std::string& name, const Model& next, control::Done& done) {
  std::vector<std::pair<decltype(wires_)::iterator, Wire>> switched;
  try {
    for (auto one = wires_.begin(); one != wires_.end(); ++one) {
      auto& [client, wire] = *one;
      if (client.first == name || wire.provider.instance() != name || lost_.contains(client.first)) continue;
      try {
        Wire now = connector_.connect(port_of(client), wire.provider, next, wire.id, done);
        switched.emplace_back(one, std::exchange(wire, std::move(now)));
      } catch (const Error& error) {
        const bool has_failed =
            error.code() == ErrorCode::ComponentFailed && error.text().where == text_of(port_of(client));
        if (!has_failed) throw;
        if (wire.reason.empty()) wire.reason = error.text().what;
      }
    }
  } catch (...) {
    const bool lives = groups_.living(model_.instance(name).group);
    for (auto& [one, before] : switched) {
      control::Done ignored;
      if (!lives) one->second.reason = before.reason.empty() ? "'" + name + "' is lost" : before.reason;
      if (lives) one->second = open_or_wait(port_of(one->first), before.provider, model_, one->second, ignored);
    }
    throw;
  }
}

/// The one that has served until now serves on: those who use it, and what it sends, have their wires to it again.
void System::switch_back(const std::string& name) {
  const Model::Instance& served = model_.instance(name);
  const bool lives = groups_.living(served.group);
  for (auto& [client, wire] : wires_) {
    const bool uses_it = client.first != name && wire.provider.instance() == name && !lost_.contains(client.first);
    const bool is_sent_by_it = client.first == name && sends(served, client.second);
    if (!uses_it && !is_sent_by_it) continue;
    control::Done ignored;
    if (!lives) wire.reason = "'" + name + "' is lost";
    if (lives)
      wire = open_or_wait(port_of(client), wire.provider, model_, uses_it ? wire : Wire{wire.provider}, ignored);
  }
}

/// From here on it is the one that serves, for all that look for it.
void System::hand_over(const Model& next, const Model::Instance& old, bool keeps) {
  const std::string name = candidate_->name;
  Beside before{.name = name, .made = old};
  for (auto one = wires_.begin(); one != wires_.end();) {
    const bool its = one->first.first == name;
    if (its) before.wires.insert(*one);
    one = its ? wires_.erase(one) : std::next(one);
  }
  for (auto& wire : candidate_->wires) wires_.insert(wire);
  candidate_.reset();
  attachments_.lose_to(name);
  made_known(old.group, name);
  model_ = next;
  set_beside(next.instance(name).group, name, false);
  set_beside(old.group, name, true);
  taps_.move(name, old.group, [&]() -> Group& { return group_of(name, model_); });
  dispose_standby(name);
  before.rests_at = std::chrono::steady_clock::now() + kDrain;
  if (!keeps) return dispose_later(std::move(before));
  standbys_.insert_or_assign(name, std::move(before));
}

/// Some of the next milliseconds of one that has taken the place of another: answered with Done when they are over, or
/// with why it is not fit.
void System::watch_upgrade(const std::string& name, double left_ms, Waits::Answer answer) {
  std::vector<Deliveries::Pair> pairs;
  double longest_ms = kDelivers_ms;
  for (const std::string& port : heard_ports(model_, name)) {
    const auto* service = service_of(model_.instance(name), port);
    if (ServiceInfo(*service).contract().lease_ms() == 0 && ServiceInfo(*service).pattern() != PUSH_TIMED) continue;
    longest_ms = std::max(longest_ms, patience_with_ms(model_.instance(name), port));
    pairs.push_back({port, new_tap(), 0});
  }
  // What is left at the end may be too short for a port to say anything.
  if (left_ms < longest_ms || model_.instance(name).mode == kModeNeutral) pairs.clear();
  const auto check = std::make_shared<Deliveries>(name, pairs);
  const auto begin = [&] {
    for (const auto& pair : pairs) {
      standbys_.at(name).taps.push_back(pair.tap);
      taps_.open(group_of(name, model_), pair.tap, sampled(name, pair.port), true);
    }
  };
  const auto end_of = [check](const wire::GroupMessage& event) { return reply_of(*check, event); };
  listen_to(check, std::min(left_ms, longest_ms), begin, end_of, std::move(answer));
}

void System::end_watch(const std::string& name) {
  const auto standby = standbys_.find(name);
  if (standby == standbys_.end()) return;
  for (const std::uint64_t tap : std::exchange(standby->second.taps, {})) taps_.close(tap);
}

void System::untap_candidate() {
  for (const std::uint64_t tap : std::exchange(candidate_->taps, {})) taps_.close(tap);
}

void System::drop_candidate() {
  if (!candidate_) return;
  untap_candidate();
  made_known(candidate_->made.group, candidate_->name);
  candidate_->rests_at.reset();
  dispose_later(std::move(*std::exchange(candidate_, std::nullopt)));
}

void System::dispose_standby(const std::string& name) {
  auto standby = standbys_.extract(name);
  if (standby.empty()) return;
  for (const std::uint64_t tap : standby.mapped().taps) taps_.close(tap);
  dispose_later(std::move(standby.mapped()));
}

/// Once what it was asked has been answered, it is destroyed; its process ends with the last instance in it.
void System::dispose_later(Beside version) { leaving_.push_back(std::move(version)); }

/// What was to leave a process that has gone has left: the next process of that name is none of its business.
void System::end_leaving(const std::string& group) {
  for (Beside& one : leaving_) {
    if (one.made.group == group) cut_beside(one);
  }
  std::erase_if(leaving_, [&](const Beside& one) { return one.made.group == group; });
}

void System::cut_beside(Beside& version) {
  for (const auto& [client, wire] : std::exchange(version.wires, {})) {
    if (wire.id == 0) continue;
    groups_.cut(version.made.group, wire.id, "another version serves");
    const auto* provider = wire.local ? nullptr : model_.find(wire.provider.instance());
    if (provider) groups_.cut(provider->group, wire.id, "another version serves");
  }
}

/// [watched] Those that stand by rest once what they were asked is answered; those that leave go then.
void System::look_after_versions(std::chrono::steady_clock::time_point now) {
  for (auto& [name, one] : standbys_) {
    Group* at = groups_.living(one.made.group);
    if (!one.rests_at || now < *one.rests_at || !at) continue;
    one.rests_at.reset();
    at->tell(mode_request(name, std::string(kModeNeutral), next_work_++, kRestsWithin_ms));
  }
  for (auto one = leaving_.begin(); one != leaving_.end();) {
    const bool stays = one->rests_at && now < *one->rests_at;
    if (!stays) destroy_version(*one);
    one = stays ? std::next(one) : leaving_.erase(one);
  }
  for (auto one = ending_.begin(); one != ending_.end();) {
    const Group* at = groups_.living(one->first);
    const bool ends = !at || !at->silent_since() || now > one->second;
    if (ends) end_group(one->first);
    one = ends ? ending_.erase(one) : std::next(one);
  }
}

/// Nobody waits for its end.
void System::destroy_version(Beside& version) {
  cut_beside(version);
  Group* at = groups_.find(version.made.group);
  if (!at) return;
  if (at->name() != kMainGroup) ending_[at->name()] = std::chrono::steady_clock::now() + kMostDestroyed;
  if (!at->alive()) return;
  wire::GroupRequest destroy;
  destroy.mutable_destroy()->set_instance(version.name);
  at->ask(std::move(destroy));
}

/// Unless somebody lives there, or stands by there.
void System::end_group(const std::string& name) {
  const auto is_there = [&](const auto& one) { return one.second.made.group == name; };
  const bool used = !model_.names_in(name).empty() || std::any_of(standbys_.begin(), standbys_.end(), is_there) ||
                    (candidate_ && candidate_->made.group == name);
  const ChildGroup* child = groups_.child(name);
  if (used || !child) return;
  if (child->alive()) groups_.tell_ended(child->endpoint(), "group '" + name + "' has ended");
  if (virtual_time_) virtual_time_->forget(child->endpoint());
  supervision_.forget(name);
  groups_.retire(name);
}

/// [any thread] What happens to it is told under another name than what happens to the one that serves.
void System::set_beside(const std::string& group, const std::string& name, bool is_beside) {
  const std::lock_guard lock(beside_mutex_);
  is_beside ? void(beside_.insert({group, name})) : void(beside_.erase({group, name}));
}

bool System::is_beside(const std::string& group, const std::string& name) {
  const std::lock_guard lock(beside_mutex_);
  return beside_.contains({group, name});
}

}  // namespace fiona::host
