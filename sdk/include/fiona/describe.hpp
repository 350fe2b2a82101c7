#pragma once

#include <set>
#include <string>

#include "fiona/manifest.pb.h"
#include "fiona/plugin.hpp"

namespace fiona {

/// Whether libfiona-msgs carries this proto file: no plugin may.
bool is_platform_proto(const std::string& file);

/// What a task, trigger or probe declares.
TaskInterface interface_of(const Task& task);
TriggerInterface interface_of(const detail::TriggerBase& trigger);
ProbeInterface interface_of(const detail::ProbeBase& probe);

/// What one component declares, read from its hull after `create`.
ComponentInterface interface_of(const Hull& hull, std::string_view component, std::string_view doc);

/// Makes each component of the plugin once, on a clock that stands and without starting it, and writes down what it
/// declares: the content of `interface.textproto`. `shared` are the proto files that message libraries have brought.
/// Throws what a constructor throws.
Interface describe(const Plugin& plugin, const std::set<std::string>& shared = {});

/// The same of a message library, which is in this process already and brings these proto files. Throws Error (Failed)
/// for a file that it does not bring.
Interface describe_messages(const std::set<std::string>& proto_files, const std::set<std::string>& shared);

/// The first way in which what a component declares differs from its package's interface, as a sentence; empty if
/// they agree.
std::string interface_difference(const ComponentInterface& declared, const ComponentInterface& packaged);

}  // namespace fiona
