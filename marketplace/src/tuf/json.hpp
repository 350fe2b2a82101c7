#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace fiona::tuf {

using Json = nlohmann::json;

/// Reads metadata strictly, so that no two readers can disagree on it: UTF-8, no name twice in an object, no number but
/// 64-bit integers (canonical JSON has no others), at most 32 levels. `where` names the file in errors. Throws
/// fiona::Error (BadSignature).
Json parse_json(std::string_view text, const std::string& where);

/// The bytes that are signed: OLPC's canonical JSON (wiki.laptop.org/go/Canonical_JSON), as TUF prescribes it. No
/// blanks, names sorted by bytes, and in strings only '"' and '\' escaped: all else stands as its UTF-8 bytes, line
/// ends too.
std::string canonical(const Json& value);

// Members of an object that must be there and of their kind; each throws fiona::Error (BadSignature) that names it.
const Json& object_in(const Json& object, const char* name, const std::string& where);
const Json& array_in(const Json& object, const char* name, const std::string& where);
const std::string& string_in(const Json& object, const char* name, const std::string& where);
/// An integer from `least` on.
std::int64_t number_in(const Json& object, const char* name, std::int64_t least, const std::string& where);
std::vector<std::string> strings_in(const Json& object, const char* name, const std::string& where);

/// Throws fiona::Error (BadSignature): "WHERE is not TUF metadata: FAULT".
[[noreturn]] void refuse_form(const std::string& where, const std::string& fault);

}  // namespace fiona::tuf
