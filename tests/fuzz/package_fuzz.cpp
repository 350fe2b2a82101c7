// The package reader, from both ends of its compression: the input is a .fpk as it comes, or (first byte odd)
// the tar archive in it, so that the fuzzer need not learn zstd to reach what lies behind.
#include <zstd.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <fiona/error.hpp>
#include <fiona/marketplace/package.hpp>
#include <string>
#include <string_view>

namespace {

using namespace fiona::marketplace;

// Asserts the order in which a sink may be called and that no file exceeds what was announced.
class CheckingSink final : public PackageSink {
 public:
  void begin(const fiona::PackageFile& file) override {
    if (open_ || (!path_fault(file.path()).empty() && file.path() != kManifestFile)) std::abort();
    open_ = true;
    left_ = file.size();
  }
  void write(std::string_view bytes) override {
    if (!open_ || bytes.size() > left_) std::abort();
    left_ -= bytes.size();
  }
  void end() override {
    if (!open_ || left_ != 0) std::abort();
    open_ = false;
  }

 private:
  bool open_ = false;
  std::uint64_t left_ = 0;
};

std::string compressed(std::string_view bytes) {
  std::string out(ZSTD_compressBound(bytes.size()), '\0');
  out.resize(ZSTD_compress(out.data(), out.size(), bytes.data(), bytes.size(), 1));
  return out;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view input{reinterpret_cast<const char*>(data) + 1, size - 1};
  const std::string package = data[0] % 2 ? compressed(input) : std::string(input);
  std::string_view rest = package;
  const auto source = [&rest](char* buffer, std::size_t most) {
    const std::size_t count = rest.copy(buffer, std::min(most, rest.size()));
    rest.remove_prefix(count);
    return count;
  };
  CheckingSink sink;
  const PackageLimits limits{
      .manifest_bytes = 1 << 16, .interface_bytes = 1 << 16, .total_bytes = 1 << 20, .files = 64};
  try {
    read_package(source, "fuzz.fpk", sink, limits);
  } catch (const fiona::Error& error) {
    if (error.text().what.empty() || error.text().next.empty()) std::abort();
  }
  return 0;
}
