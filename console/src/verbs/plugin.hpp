#pragma once

#include <filesystem>

#include "../author/plugin_files.hpp"
#include "../session.hpp"

namespace fiona::console::verbs {

/// Configures, where that has not been done, and builds an author's folder, and passes on what is said. Throws
/// fiona::Error (Failed, Unreachable at the deadline).
void build_plugin(Session& session, const std::filesystem::path& folder, SteadyTime deadline);

/// The folder that stands at a place of the line, else the working directory.
std::filesystem::path typed_folder(const Line& line, std::size_t at);

/// When the `for` of a line is over; by default in ten minutes.
SteadyTime build_deadline(const Line& line);

/// What the package of an author's folder is. Throws fiona::Error (Failed) for a manifest that is none.
fiona::PackageKind kind_of(const PluginFiles& files);

/// Whether packages of a kind have one, which is to be built.
bool has_library(fiona::PackageKind kind);

marketplace::Store store_of(const Session& session);

/// `with unconfined`, or not.
Confinement confinement_of(const Line& line);

void plugin_test(Session& session, const Line& line);

}  // namespace fiona::console::verbs
