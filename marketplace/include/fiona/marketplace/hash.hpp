#pragma once

#include <memory>
#include <string>
#include <string_view>

namespace fiona::marketplace {

/// BLAKE2b-256 (RFC 7693) of bytes that arrive in pieces: the hash that manifests, indexes and stores speak
/// of.
class Blake2b {
 public:
  Blake2b();
  ~Blake2b();
  Blake2b(const Blake2b&) = delete;
  Blake2b& operator=(const Blake2b&) = delete;

  void update(std::string_view bytes);

  /// 64 lower-case hex digits. Ends the hash: nothing may be added afterwards.
  std::string finish();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// The hash of bytes that are at hand.
std::string blake2b(std::string_view bytes);

/// Whether `text` has the shape of a hash: 64 lower-case hex digits.
bool is_blake2b(std::string_view text);

}  // namespace fiona::marketplace
