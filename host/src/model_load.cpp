// What an instance is loaded with: rights, parameters, a mode.
#include <fmt/format.h>

#include <algorithm>

#include "confinement.hpp"
#include "fiona/error.hpp"
#include "fiona/hull.hpp"
#include "fiona/marketplace/manifest.hpp"
#include "fiona/params.hpp"
#include "model.hpp"

namespace fiona::host {
namespace {

/// Its parameters with the changes made. Throws as `set_fields` does, with the instance as the place.
std::shared_ptr<Object> changed(const std::string& name, const Model::Instance& one,
                                const google::protobuf::RepeatedPtrField<control::Argument>& changes,
                                const std::string& next) {
  if (!one.parameters)
    throw Error(ErrorCode::NotFound,
                {.what = "'" + name + "' has no parameters", .where = name, .next = "show " + name});
  std::shared_ptr<Object> draft = one.empty_parameters();
  draft->CopyFrom(*one.parameters);
  try {
    const std::vector<control::Argument> arguments(changes.begin(), changes.end());
    set_fields(*draft, arguments);
  } catch (const Error& error) {
    ErrorText text = error.text();
    if (text.where.empty()) text.where = name;
    if (text.next.empty()) text.next = next;
    throw Error(error.code(), std::move(text));
  }
  return draft;
}

/// Whether a manifest asks for that, or for a folder in which it lies: no more need be granted than is needed.
bool is_asked_for(const std::vector<std::string>& asked, std::string_view right) {
  return std::any_of(asked.begin(), asked.end(), [&](const std::string& one) {
    const bool of_files = one.starts_with("read:/") || one.starts_with("write:/");
    return one == right || (of_files && right.starts_with(one.ends_with('/') ? one : one + "/"));
  });
}

/// What is granted must be asked for, by the component's code and by the manifest that its users have read.
void require_rights(const control::Load& request, const Model::Instance& made) {
  const std::vector<std::string> known{"master",           "network",     "device:NAME",
                                       "read:/PATH",       "write:/PATH", "system-bus:NAME",
                                       "session-bus:NAME", "unconfined",  "confined"};
  const std::vector<std::string> of_operator{std::string(kUnconfined), std::string(kConfined)};
  const auto has = [](const auto& list, const std::string& right) {
    return std::find(list.begin(), list.end(), right) != list.end();
  };
  for (const std::string& right : request.rights()) {
    if (has(of_operator, right)) continue;
    if (!has(known, right) && !marketplace::opens_sandbox(right)) {
      throw Error(ErrorCode::Usage, {.what = fmt::format("there is no right '{}' that could be granted", right),
                                     .expected = fmt::format("{}", fmt::join(known, ", ")),
                                     .near = nearest_names(right, known)});
    }
    if (!marketplace::opens_sandbox(right) && !has(made.interface().rights(), right)) {
      throw Error(ErrorCode::Usage, {.what = fmt::format("'{}' has no use for the right '{}'", made.component, right),
                                     .expected = "a component that has a fiona::Master",
                                     .next = fmt::format("load {}, without it", request.plugin())});
    }
    if (!is_asked_for(made.package->rights, right)) {
      throw Error(ErrorCode::NotAllowed,
                  {.what = fmt::format("{} cannot be granted the right '{}': its manifest does not ask for it",
                                       made.package->name, right),
                   .expected = fmt::format("rights: \"{}\" in its manifest", right),
                   .next = "tell the publisher"});
    }
  }
}

}  // namespace

std::shared_ptr<Object> Model::Instance::empty_parameters() const {
  const std::string& type = interface().parameters();
  return type.empty() ? nullptr : Types::make(package->types, type);
}

std::shared_ptr<Object> Model::Instance::default_parameters() const {
  std::shared_ptr<Object> values = empty_parameters();
  if (values) set_declared_defaults(*values);
  return values;
}

std::string Model::Instance::mode_after_load() const {
  if (!mode_at_load.empty()) return mode_at_load;
  const auto& modes = interface().modes();
  return modes.empty() ? std::string(kModeActive) : modes.Get(0).name();
}

void Model::load(const control::Load& request, const Packages& packages) {
  const auto [package, component] = packages.find(request.plugin(), request.version());
  const std::string name = request.instance().empty() ? component : request.instance();
  require_name(name, "an instance");
  if (const Instance* taken = find(name)) {
    throw Error(ErrorCode::Usage,
                {.what = "there is an instance '" + name + "' already",
                 .found = taken->package->name,
                 .next = fmt::format("load {} as OTHER-NAME, or: unload {}", request.plugin(), name)});
  }
  auto made = std::make_shared<Instance>();
  made->plugin = request.plugin();
  made->package = package;
  made->component = component;
  made->mode_at_load = request.mode();
  made->order = next_order_;
  made->rights = {request.rights().begin(), request.rights().end()};
  made->comment = request.comment();
  // A stranger gets a process of its own, of its name.
  const bool shares_main =
      is_let_in(*package) || std::find(made->rights.begin(), made->rights.end(), kUnconfined) != made->rights.end();
  made->group = !request.group().empty() ? request.group() : shares_main ? std::string(kMainGroup) : name;
  require_rights(request, *made);
  made->mode = made->mode_after_load();
  made->parameters = made->default_parameters();
  if (request.parameters_size() > 0) {
    made->parameters =
        changed(name, *made, request.parameters(), "'" + name + "' was not loaded: correct that, then load it again");
  }
  instances_[name] = std::move(made);
  try {
    require_waiting_fit(name);
  } catch (const Error& error) {
    instances_.erase(name);
    ErrorText text = error.text();
    text.what = "a wire waits for '" + name + "' and does not fit it: " + text.what;
    throw Error(error.code(), std::move(text));
  }
  ++next_order_;
}

std::string Model::Instance::source() const {
  return (package->installed() ? package->name : package->library.string()) + "/" + component;
}

void Model::upgrade(const std::string& name, std::shared_ptr<const Package> package, const std::string& group) {
  require_own(name);
  const auto before = instances_.at(name);
  const std::string found = fmt::format("{} {}", package->name, package->version);
  auto made = std::make_shared<Instance>(*before);
  made->package = std::move(package);
  made->group = group;
  // What it does not ask for any more it is not given.
  std::erase_if(made->rights, [&](const std::string& right) {
    const auto& asked = made->package->rights;
    return right != kUnconfined && right != kConfined && std::find(asked.begin(), asked.end(), right) == asked.end();
  });
  try {
    const auto& modes = made->interface().modes();
    const bool knows_mode =
        made->mode == kModeNeutral || (modes.empty() && made->mode == kModeActive) ||
        std::any_of(modes.begin(), modes.end(), [&](const auto& m) { return m.name() == made->mode; });
    if (!knows_mode) {
      throw Error(ErrorCode::NotAllowed,
                  {.what = fmt::format("it has no mode '{}', which '{}' is in", made->mode, name),
                   .where = name,
                   .next = fmt::format("bring it into a mode that both have: state {} {}", name, kModeNeutral)});
    }
    made->parameters = made->default_parameters();
    const auto set = before->parameters ? differences(*before->parameters, *before->default_parameters())
                                        : std::vector<control::Argument>();
    if (!set.empty()) {
      made->parameters = changed(name, *made, {set.begin(), set.end()}, "set " + name + " to what both take");
    }
    instances_[name] = std::move(made);
    require_wires_fit(name);
  } catch (const Error& error) {
    instances_[name] = before;
    ErrorText text = error.text();
    text.what = fmt::format("{} cannot take the place of {}: {}", found, before->package->version, text.what);
    throw Error(error.code(), std::move(text));
  }
}

/// All that begin or end there.
void Model::require_wires_fit(const std::string& name) const {
  for (const auto& [client, wire] : wires_) {
    for (const auto& provider : wire.providers) {
      if ((client.first == name || provider.instance() == name) && find(provider.instance()))
        require_fit(port_of(client), provider);
    }
    if (client.first == name) port(port_of(client), REQUIRES);
  }
}

/// The wires that wait for this instance.
void Model::require_waiting_fit(const std::string& name) const {
  for (const auto& [client, wire] : wires_) {
    for (const auto& provider : wire.providers) {
      if (provider.instance() == name) require_fit(port_of(client), provider);
    }
  }
}

void Model::set(const control::Set& request) {
  require_own(request.instance());
  auto draft = std::make_shared<Instance>(instance(request.instance()));
  draft->parameters = changed(request.instance(), *draft, request.parameters(), "get " + request.instance());
  instances_[request.instance()] = std::move(draft);
}

control::Load Model::load_of(const std::string& name) const {
  const Instance& one = instance(name);
  control::Load load;
  load.set_plugin(one.plugin);
  load.set_instance(name);
  if (one.group != kMainGroup) load.set_group(one.group);
  if (one.package->installed()) load.set_version(one.package->version);
  load.set_mode(one.mode_at_load);
  load.mutable_rights()->Add(one.rights.begin(), one.rights.end());
  load.set_comment(one.comment);
  if (!one.parameters) return load;
  for (auto& changed : differences(*one.parameters, *one.default_parameters()))
    *load.add_parameters() = std::move(changed);
  return load;
}

}  // namespace fiona::host
