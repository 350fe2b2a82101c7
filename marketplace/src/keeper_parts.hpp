#pragma once

#include <filesystem>
#include <fiona/marketplace/keeper.hpp>
#include <optional>
#include <string>

namespace fiona::marketplace {

tuf::Time now_of(const KeeperOptions& options);

/// The marketplace as a repository, and where its keeper has what he has seen of it.
tuf::RepositoryOptions repository_options(const std::filesystem::path& market, const KeeperOptions& options);

/// A file of metadata; nothing where there is none.
std::optional<std::string> content_if_there(const std::filesystem::path& path);

}  // namespace fiona::marketplace
