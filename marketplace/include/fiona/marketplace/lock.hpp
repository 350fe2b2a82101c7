#pragma once

#include <filesystem>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/store.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::marketplace {

/// These packages of a store and all that they require; none named: everything that is installed. Throws fiona::Error
/// (NotFound) for one that is not installed.
Lock make_lock(const Store& store, const std::optional<std::vector<std::string>>& packages);

/// Throws fiona::Error (Failed).
void write_lock(const std::filesystem::path& file, const Lock& lock);

/// Checks a lock's text; `where` names it in errors. Throws fiona::Error (Failed) with line and column.
Lock parse_lock(std::string_view text, const std::string& where);

/// Throws fiona::Error: NotFound, Failed with line and column of what is wrong.
Lock read_lock(const std::filesystem::path& file);

/// Those of its packages that this marketplace has, to the byte.
Lock part_of(const Lock& lock, const Marketplace& market);

}  // namespace fiona::marketplace
