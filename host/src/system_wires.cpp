// Wires as they are asked for: to one provider or to several, waiting for one, let go of, lost.
#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "fiona/error.hpp"
#include "fiona/probe.pb.h"
#include "system.hpp"

namespace fiona::host {
namespace {

std::string waiting_for(const std::string& provider) { return "there is no instance '" + provider + "' yet"; }

std::string waiting_warning(const control::PortName& client, const std::string& provider, const Model& next) {
  const auto near = nearest_names(provider, next.names());
  return text_of(client) + " waits: " + waiting_for(provider) +
         (near.empty() ? "" : fmt::format("; did you mean {}?", fmt::join(near, ", ")));
}

wire::GroupRequest arrangement(const control::PortName& client, const std::vector<control::PortName>& providers,
                               double hold_ms, const std::vector<std::uint64_t>& retires) {
  wire::GroupRequest request;
  auto& arrange = *request.mutable_arrange();
  *arrange.mutable_client() = client;
  arrange.mutable_providers()->Add(providers.begin(), providers.end());
  arrange.set_hold_ms(hold_ms);
  arrange.mutable_retires()->Add(retires.begin(), retires.end());
  return request;
}

}  // namespace

wire::GroupRequest System::prescaled(std::uint64_t wire, std::uint32_t prescale) {
  wire::GroupRequest request;
  request.mutable_set_prescale()->set_wire(wire);
  request.mutable_set_prescale()->set_prescale(prescale);
  return request;
}

control::Done System::wire(const control::Wire& request, const Model& next, bool restores) {
  const Model::Wire* before = model_.wire_of(request.client());
  const Model::Wire& wanted = *next.wire_of(request.client());
  const auto [first, last] = wires_.equal_range(key_of(request.client()));
  const bool all_well = std::all_of(first, last, [](const auto& one) { return one.second.reason.empty(); });
  if (before && all_well && *before == wanted) {
    control::Done done;
    done.set_note("wired so already");
    return done;
  }
  if (before && all_well && before->with_prescale(wanted.prescale) == wanted)
    return set_prescale(request.client(), *before, wanted);
  const bool several = wanted.providers.size() > 1 || (before && before->providers.size() > 1);
  control::Done done =
      several ? wire_several(request.client(), next, restores) : wire_one(request.client(), next, restores);
  std::string note = text_of(request.client()) + (done.warnings_size() > 0 && !several ? " waits for " : " to ") +
                     text_of(request.provider());
  for (const auto& provider : request.alternatives()) note += " else " + text_of(provider);
  done.set_note(note);
  return done;
}

/// The wires stay as they are.
control::Done System::set_prescale(const control::PortName& client, const Model::Wire& before,
                                   const Model::Wire& wanted) {
  const auto [first, last] = wires_.equal_range(key_of(client));
  const auto tell = [&](const Wire& wire, std::uint32_t prescale) {
    group_of(wire.provider.instance(), model_).request(prescaled(wire.id, prescale));
  };
  for (auto one = first; one != last; ++one) {
    try {
      tell(one->second, wanted.prescale);
    } catch (...) {
      for (auto told = first; told != one; ++told) tell(told->second, before.prescale);
      throw;
    }
  }
  control::Done done;
  done.set_note(fmt::format("{} takes every {}", text_of(client), wanted.prescale));
  return done;
}

control::Done System::wire_one(const control::PortName& client, const Model& next, bool restores) {
  const control::PortName& provider = next.wire_of(client)->providers.front();
  const auto old = wires_.find(key_of(client));
  control::Done done;
  Wire made{provider, 0, false, waiting_for(provider.instance()), {}};
  if (next.find(provider.instance())) {
    const Wire before = old == wires_.end() ? Wire{provider} : old->second;
    try {
      made = connector_.connect(client, provider, next, before.id, done);
    } catch (const Error& error) {
      if (!restores || error.code() != ErrorCode::ComponentFailed) throw;
      made = open_or_wait(client, provider, next, before, done);
    }
  } else {
    if (old != wires_.end()) connector_.disconnect(client, old->second, made.reason);
    await_provider(client, made, next);
    done.add_warnings(waiting_warning(client, provider.instance(), next));
  }
  wires_.erase(key_of(client));
  wires_.emplace(key_of(client), std::move(made));
  return done;
}

/// Those that it keeps stay as they are. The new ones are opened before those that go are let go of, so that at every
/// moment somebody serves. One that does not open waits: that is what its alternatives are for; but where somebody
/// serves and none of those that are wanted opens, all stays as it is.
control::Done System::wire_several(const control::PortName& client, const Model& next, bool restores) {
  const Model::Wire& wanted = *next.wire_of(client);
  const Model::Wire* before = model_.wire_of(client);
  const bool as_before = before && before->prescale == wanted.prescale;
  std::vector<Wire> old;
  for (auto [it, last] = wires_.equal_range(key_of(client)); it != last; ++it) old.push_back(it->second);
  std::vector<control::PortName> meanwhile = wanted.providers;
  std::vector<std::uint64_t> retires;
  for (const Wire& one : old) {
    const auto same = [&](const auto& name) { return key_of(name) == key_of(one.provider); };
    if (std::any_of(wanted.providers.begin(), wanted.providers.end(), same)) continue;
    meanwhile.push_back(one.provider);
    if (one.id != 0) retires.push_back(one.id);
  }
  control::Done done;
  std::vector<Wire> now;
  std::optional<Error> refusal;
  try {
    arrange(client, meanwhile, wanted.hold_ms, {}, next, nullptr);
    for (const auto& provider : wanted.providers) {
      const Wire* known = wire_to(key_of(client), provider);
      if (known && known->is_open()) {
        now.push_back(as_before ? *known : connector_.connect(client, provider, next, known->id, done));
      } else {
        now.push_back(open_or_wait(client, provider, next, known ? *known : Wire{provider}, done, &refusal));
      }
    }
    const auto is_open = [](const Wire& one) { return one.is_open(); };
    if (refusal && !(restores && refusal->code() == ErrorCode::ComponentFailed) &&
        std::any_of(old.begin(), old.end(), is_open) && std::none_of(now.begin(), now.end(), is_open))
      throw *refusal;
    arrange(client, wanted.providers, wanted.hold_ms, retires, next, &done);
  } catch (...) {
    take_back_wires(client, now);
    throw;
  }
  wires_.erase(key_of(client));
  for (Wire& one : now) wires_.emplace(key_of(client), std::move(one));
  return done;
}

/// The port has the providers that it had, over the wires that there are to them; a process that does not answer does
/// that once it comes to it.
void System::take_back_wires(const control::PortName& client, const std::vector<Wire>& made) {
  const Model::Wire before = model_.wire_of(client) ? *model_.wire_of(client) : Model::Wire{};
  const auto [first, last] = wires_.equal_range(key_of(client));
  for (const Wire& one : made) {
    const auto same = [&](const auto& old) { return key_of(old.second.provider) == key_of(one.provider); };
    const auto known = std::find_if(first, last, same);
    if (known == last) {
      connector_.disconnect(client, one, "it was not wired so");
      continue;
    }
    const bool anew = std::exchange(known->second, one).id != one.id;
    Group* to = anew && one.is_open() ? groups_.living(model_.instance(one.provider.instance()).group) : nullptr;
    if (to) to->inform(prescaled(one.id, before.prescale));
  }
  Group* at = groups_.living(model_.instance(client.instance()).group);
  if (at) at->inform(arrangement(client, before.providers, before.hold_ms, {}));
}

System::Wire System::open_or_wait(const control::PortName& client, const control::PortName& provider, const Model& next,
                                  const Wire& old, control::Done& done, std::optional<Error>* refusal) {
  Wire waiting{provider, 0, false, waiting_for(provider.instance()), {}};
  try {
    if (next.find(provider.instance())) return connector_.connect(client, provider, next, old.id, done);
    done.add_warnings(waiting_warning(client, provider.instance(), next));
  } catch (const Error& error) {
    if (refusal && !*refusal) *refusal = error;
    waiting.waits_for(error);
    done.add_warnings(fmt::format("{} waits for {}: {}", text_of(client), text_of(provider), waiting.reason));
  }
  connector_.disconnect(client, old, waiting.reason);
  await_provider(client, waiting, next);
  return waiting;
}

void System::await_provider(const control::PortName& client, const Wire& wire, const Model& model) {
  if (lost_.contains(client.instance())) return;
  wire::GroupRequest request;
  *request.mutable_await()->mutable_client() = client;
  *request.mutable_await()->mutable_provider() = wire.provider;
  request.mutable_await()->set_reason(wire.reason);
  if (Group* at = groups_.living(model.instance(client.instance()).group)) at->inform(std::move(request));
}

void System::arrange(const control::PortName& client, const std::vector<control::PortName>& providers, double hold_ms,
                     const std::vector<std::uint64_t>& retires, const Model& model, control::Done* cost) {
  Group& at = group_of(client.instance(), model);
  const auto reply = at.request(arrangement(client, providers, hold_ms, retires));
  if (!cost || retires.empty()) return;
  Connector::add_cost(*cost, reply.switched(), static_cast<std::uint32_t>(retires.size()));
}

control::Done System::unwire(const control::Unwire& request) {
  const auto [first, last] = wires_.equal_range(key_of(request.client()));
  // Of several, or cut from nothing: the port is told that it has none from now on.
  const bool tells = std::next(first) != last || first->second.id == 0;
  if (tells && !lost_.contains(request.client().instance())) {
    arrange(request.client(), {}, Model::Wire::kHold_ms, {}, model_, nullptr);
  }
  for (auto it = first; it != last; ++it) connector_.disconnect(request.client(), it->second, "unwired");
  wires_.erase(first, last);
  control::Done done;
  done.set_note(text_of(request.client()) + " unwired");
  return done;
}

/// The wires that have waited for an instance that is there now; what came of it, as a note.
std::string System::connect_waiting(const std::string& provider, const Model& next) {
  std::vector<std::string> connected;
  std::string note;
  for (auto& [key, wire] : wires_) {
    const control::PortName client = port_of(key);
    if (wire.id != 0 || wire.provider.instance() != provider || !next.wire_of(client)) continue;
    try {
      control::Done ignored;
      wire = connector_.connect(client, wire.provider, next, 0, ignored);
      connected.push_back(text_of(client));
    } catch (const Error& error) {
      wire.waits_for(error);
      note += fmt::format("; {} still waits: {}", text_of(client), wire.reason);
    }
  }
  return connected.empty() ? note : fmt::format("; had waited for it: {}", fmt::join(connected, ", ")) + note;
}

/// The wires of an instance that is unloaded: its own end, and those of its clients wait. Returns those, as texts.
std::vector<std::string> System::leave_wires(const std::string& name) {
  std::vector<std::string> dependents;
  for (auto it = wires_.begin(); it != wires_.end();) {
    const control::PortName client = port_of(it->first);
    const bool is_client = client.instance() == name;
    const bool is_provider = it->second.provider.instance() == name;
    if (is_client || is_provider) connector_.disconnect(client, it->second, name + " was unloaded");
    if (!is_client && is_provider) {
      const bool alone = model_.wire_of(client)->providers.size() == 1;
      dependents.push_back(text_of(client) + (alone ? "" : ", which has alternatives"));
      it->second = Wire{it->second.provider, 0, false, waiting_for(name), {}};
      await_provider(client, it->second, model_);
    }
    it = is_client ? wires_.erase(it) : std::next(it);
  }
  return dependents;
}

/// Those that begin or end in a group that has gone.
void System::lose_wires(const std::string& gone, const std::string& reason) {
  for (auto& [key, wire] : wires_) {
    const Model::Instance* provider = model_.find(wire.provider.instance());
    const bool client_gone = model_.instance(key.first).group == gone;
    const bool provider_gone = provider && provider->group == gone;
    if (wire.id == 0 || (!client_gone && !provider_gone)) continue;
    wire.reason = reason;
    if (!client_gone || provider_gone || !provider) continue;
    // A process of this host has been told of the end of another; one elsewhere must not go on sending to nobody.
    const bool knows = host_of(gone).empty() && host_of(provider->group).empty();
    if (!knows) groups_.cut(provider->group, wire.id, reason);
  }
  if (!candidate_) return;
  for (auto& [key, wire] : candidate_->wires) {
    const Model::Instance* provider = model_.find(wire.provider.instance());
    if (wire.id != 0 && provider && provider->group == gone) wire.reason = reason;
  }
}

control::Attached System::attach(std::uint64_t owner, const control::Attach& request) {
  if (has_virtual_clock()) {
    throw Error(ErrorCode::NotAllowed,
                {.what = "a virtual clock waits for its own processes only: nobody outside may take part",
                 .next = "attach to a host with the system clock"});
  }
  const ServiceContract contract = contract_for(request, model_);
  const std::string& provider = request.provider().instance();
  if (const std::string host = host_of_instance(provider); !host.empty()) {
    throw Error(ErrorCode::NotAllowed,
                {.what = fmt::format("{} is on host '{}'", text_of(request.provider()), host), .next = "attach there"});
  }
  attachments_.require_room(owner);
  require_descriptors_for("another client", child_groups().size() + attachments_.clients(),
                          options_.group_limits.descriptors);
  Group& group = group_of(provider, model_);
  return attachments_.open(owner, request, contract, group, connector_.new_number());
}

void System::on_wire_lost(std::uint64_t id, const std::string& reason) {
  for (auto& [client, wire] : wires_) {
    if (wire.id == id) wire.reason = reason;
  }
  if (candidate_) {
    for (auto& [client, wire] : candidate_->wires) {
      if (wire.id == id) wire.reason = reason;
    }
  }
  attachments_.end(id);
}

const System::Wire* System::wire_to(const PortKey& client, const control::PortName& provider) const {
  const auto [first, last] = wires_.equal_range(client);
  const auto found =
      std::find_if(first, last, [&](const auto& one) { return key_of(one.second.provider) == key_of(provider); });
  return found == last ? nullptr : &found->second;
}

/// The provider of a wired port; of several the one that serves now.
control::PortName System::served_by(const control::PortName& client) {
  const Model::Wire& wire = *model_.wire_of(client);
  if (wire.providers.size() == 1) return wire.providers.front();
  control::PortName probe = client;
  probe.set_port(client.port() + ".serving");
  probe::Text serving;
  serving.ParseFromString(read(probe).object());
  const auto found = std::find_if(wire.providers.begin(), wire.providers.end(),
                                  [&](const auto& one) { return text_of(one) == serving.value(); });
  return found == wire.providers.end() ? wire.providers.front() : *found;
}

}  // namespace fiona::host
