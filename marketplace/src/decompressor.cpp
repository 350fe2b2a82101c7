#include "decompressor.hpp"

#include <zstd.h>

#include <fiona/error.hpp>

namespace fiona::marketplace {
namespace {

constexpr std::size_t kChunk = std::size_t{1} << 16;
constexpr std::string_view kMagic = "\x28\xb5\x2f\xfd";  // RFC 8878, 3.1.1

}  // namespace

Decompressor::Decompressor(const ByteSource& source, std::uint64_t most, std::string where)
    : source_(source),
      most_(most),
      where_(std::move(where)),
      context_(ZSTD_createDCtx(), ZSTD_freeDCtx),
      input_(kChunk, '\0'),
      output_(kChunk, '\0') {
  ZSTD_DCtx_setParameter(context_.get(), ZSTD_d_windowLogMax, kWindowLog);
  check_begin();
}

// A frame of the kind that decoders skip would make a second, hidden content: the magic number is asked for
// first.
void Decompressor::check_begin() {
  std::size_t used = 0;
  while (used < kMagic.size()) {
    const std::size_t count = source_(input_.data() + used, input_.size() - used);
    if (count == 0) break;
    used += count;
  }
  rest_ = std::string_view(input_).substr(0, used);
  if (!rest_.starts_with(kMagic)) {
    throw Error(ErrorCode::Failed, ErrorText{.what = "this is not a package: it does not begin as zstd does",
                                             .where = where_,
                                             .next = "give a .fpk file, as fiona-pack writes it"});
  }
  hash_.update(rest_);
  size_ = used;
}

void Decompressor::refill() {
  const std::size_t count = source_(input_.data(), input_.size());
  rest_ = std::string_view(input_).substr(0, count);
  hash_.update(rest_);
  size_ += count;
  if (size_ > most_) {
    throw Error(ErrorCode::Failed, ErrorText{.what = "the package is larger than a package may be",
                                             .where = where_,
                                             .expected = "at most " + std::to_string(most_) + " bytes"});
  }
}

std::string_view Decompressor::next() {
  ZSTD_outBuffer out{output_.data(), output_.size(), 0};
  while (!ended_ && out.pos == 0) {
    if (rest_.empty()) refill();
    if (rest_.empty()) {
      throw Error(ErrorCode::Failed,
                  ErrorText{.what = "the package ends too early", .where = where_, .next = "fetch it again"});
    }
    ZSTD_inBuffer in{rest_.data(), rest_.size(), 0};
    const std::size_t result = ZSTD_decompressStream(context_.get(), &out, &in);
    rest_.remove_prefix(in.pos);
    if (ZSTD_isError(result)) {
      throw Error(ErrorCode::Failed,
                  ErrorText{.what = std::string("the package cannot be decompressed: ") + ZSTD_getErrorName(result),
                            .where = where_,
                            .expected = "zstd with a window of at most 8 MiB"});
    }
    ended_ = result == 0;
  }
  if (ended_ && rest_.empty()) refill();
  if (ended_ && !rest_.empty()) {
    throw Error(ErrorCode::Failed, ErrorText{.what = "the package has bytes after its end",
                                             .where = where_,
                                             .next = "fetch it again, or ask its publisher to pack it anew"});
  }
  return std::string_view(output_).substr(0, out.pos);
}

}  // namespace fiona::marketplace
