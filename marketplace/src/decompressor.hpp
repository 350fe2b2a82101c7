#pragma once

#include <cstdint>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/package.hpp>
#include <memory>
#include <string>
#include <string_view>

struct ZSTD_DCtx_s;

namespace fiona::marketplace {

/// log2 of the largest zstd window that a package may ask its readers to keep in memory: 8 MiB.
inline constexpr int kWindowLog = 23;

/// Undoes the compression of a package from an untrusted source: exactly one zstd frame and nothing after it.
/// Throws fiona::Error (Failed) for anything else, and for more than `most` compressed bytes.
class Decompressor {
 public:
  Decompressor(const ByteSource& source, std::uint64_t most, std::string where);

  /// The next bytes, at most 64 KiB, valid until the next call; empty at the end.
  std::string_view next();

  /// Once the end was reached: what the compressed bytes were.
  std::uint64_t size() const noexcept { return size_; }
  std::string blake2b() { return hash_.finish(); }

 private:
  void refill();
  void check_begin();

  const ByteSource& source_;
  std::uint64_t most_;
  std::string where_;
  std::unique_ptr<ZSTD_DCtx_s, std::size_t (*)(ZSTD_DCtx_s*)> context_;
  std::string input_, output_;
  std::string_view rest_;  // of input_
  std::uint64_t size_ = 0;
  bool ended_ = false;
  Blake2b hash_;
};

}  // namespace fiona::marketplace
