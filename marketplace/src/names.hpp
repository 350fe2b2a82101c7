#pragma once

#include <fiona/error.hpp>
#include <set>
#include <string>
#include <string_view>

namespace fiona::marketplace {

/// The one full name that "name" or "publisher/name" means among `known` full names. Throws fiona::Error
/// (NotFound) that begins with `unknown` if there is none, with the nearest names; or names the candidates if
/// there are several.
std::string resolve_name(std::string_view typed, const std::set<std::string>& known, const std::string& unknown,
                         const std::string& where, const std::string& next);

}  // namespace fiona::marketplace
