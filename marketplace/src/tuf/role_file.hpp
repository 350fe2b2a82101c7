#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/trust/signing_key.hpp"
#include "fiona/trust/tuf_client.hpp"
#include "json.hpp"

namespace fiona::tuf {

// Writing metadata; metadata.hpp reads it.

Json key_json(const OpenKey& key);

/// {"_type", "spec_version", "version": 1, "expires"}.
Json new_role(std::string_view type, Time expires);

/// The version that follows. Throws fiona::Error (Failed) for the last that there is.
std::int64_t version_after(std::int64_t version);

/// The next version of a role, valid until then.
void raise_version(Json& role, Time expires);

/// A whole file, signed by these keys.
std::string signed_role_file(const Json& role, const std::vector<SigningKey>& keys);

/// What "signed" says in a file that was verified.
Json role_in(std::string_view file);

/// {"length", "hashes"} of a target or a metadata file, with SHA-256.
Json described(std::string_view bytes);
Json described(std::uint64_t length, const std::string& sha256);

}  // namespace fiona::tuf
