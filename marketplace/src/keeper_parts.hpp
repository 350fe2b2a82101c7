#pragma once

#include <filesystem>
#include <fiona/marketplace/keeper.hpp>
#include <optional>
#include <string>

namespace fiona::marketplace {

tuf::Time now_of(const KeeperOptions& options);

/// Where a marketplace is, however it was typed: absolute, without a '/' at its end.
std::filesystem::path place_of(const std::filesystem::path& market);

/// What its keys are named after: its last name, as far as a key can have that.
std::string key_name_of(const std::filesystem::path& place);

/// The marketplace as a repository, and where its keeper has what he has seen of it.
tuf::RepositoryOptions repository_options(const std::filesystem::path& market, const KeeperOptions& options);

/// A file of metadata; nothing where there is none.
std::optional<std::string> content_if_there(const std::filesystem::path& path);

}  // namespace fiona::marketplace
