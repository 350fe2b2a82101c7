#pragma once

#include <string>
#include <vector>

#include "fiona/wire.pb.h"
#include "model.hpp"

namespace fiona::host {

/// Whether a package may share the rights of the host, and its process, without being asked for: those of this project,
/// which the shipped configuration lets in, and libraries that were typed by their path.
bool is_let_in(const Package& package);
/// Whether the group of this instance, its first one, is a sandbox.
bool is_confined(const Model::Instance& first);
/// What an instance was granted that says how its process is confined: all but what the leader itself watches over.
std::vector<std::string> rights_of_process(const Model::Instance& one);

/// In the folder of a host's sockets: where its groups reach D-Bus, each in a folder that no other one has in reach.
inline constexpr std::string_view kBusesFolder = "buses";

/// What the group of this instance, its first one, may take and reach. `links` is where the host's processes listen,
/// `own` the folder in it where this one does.
wire::Confinement confinement_of(const Model::Instance& first, const std::filesystem::path& links,
                                 const std::filesystem::path& own);

/// Throws Error NotAllowed if what a sandbox cannot do without is missing.
void require_sandbox(const std::string& group, const wire::Ready& ready);

/// Throws Error NotAllowed if an instance may not come into this group, which others are in (the first of them; null:
/// none).
void require_group(const Model::Instance* first, const Model::Instance& next, const std::string& plugin);

}  // namespace fiona::host
