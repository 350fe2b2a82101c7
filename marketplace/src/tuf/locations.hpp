#pragma once

#include <string>
#include <string_view>

namespace fiona::tuf {

/// A path or file://, not a server.
bool is_directory_location(std::string_view base);

/// percent_encoded(), and "." and ".." encoded too: a name that stands alone in a directory or a URL.
std::string percent_encoded_file(std::string_view name);

/// The same of each name between '/'.
std::string percent_encoded_path(std::string_view path);

/// The other way; a '%' without two hexadecimal digits stands for itself.
std::string percent_decoded(std::string_view text);

}  // namespace fiona::tuf
