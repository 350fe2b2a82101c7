#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace fiona::tuf {

/// Lower-case hexadecimal digests by the name of their algorithm, as metadata lists them.
using Hashes = std::map<std::string, std::string>;

/// "sha256", "sha384", "sha512", "blake2b-256", "blake2b" (512 bits) or "blake2s".
bool is_known_hash(const std::string& algorithm);

/// Several digests of bytes that arrive in pieces.
class Digests {
 public:
  /// One of each of `wanted` that is known.
  explicit Digests(const Hashes& wanted);
  ~Digests();
  Digests(Digests&&) noexcept;

  void update(std::string_view bytes);
  /// Ends the digests.
  Hashes finish();

 private:
  struct State;
  std::vector<State> states_;
};

std::string sha256_hex(std::string_view bytes);
std::string to_hex(std::string_view bytes);
/// Nothing where `text` is not hexadecimal, of either case.
std::string from_hex(std::string_view text);

}  // namespace fiona::tuf
