// The package reader, from three ends: the input is (by the first byte) a .fpk as it comes; the tar archive in it, so
// that the fuzzer need not learn zstd to reach what lies behind; or the texts in that, so that it need not learn
// hashes.
#include <google/protobuf/stubs/logging.h>
#include <google/protobuf/text_format.h>
#include <zstd.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <fiona/error.hpp>
#include <fiona/marketplace/compiled_protos.hpp>
#include <fiona/marketplace/hash.hpp>
#include <fiona/marketplace/package.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "tar_writer.hpp"

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

std::vector<std::string> split(std::string_view text) {
  std::vector<std::string> parts;
  for (std::size_t end = 0; end != std::string_view::npos; text.remove_prefix(std::min(end + 1, text.size()))) {
    end = text.find('\xff');
    parts.emplace_back(text.substr(0, end));
  }
  return parts;
}

// What packing does, without its checks: sizes and hashes of the files that the manifest lists, and of the proto files.
void complete(fiona::Manifest& manifest, const std::vector<std::string>& contents) {
  fiona::Interface interface;
  if (google::protobuf::TextFormat::ParseFromString(contents.front(), &interface) && manifest.shared().empty())
    list_protos(interface, manifest);
  for (int i = 0; i < manifest.files_size(); ++i) {
    const std::string& content = contents.at(static_cast<std::size_t>(i) % contents.size());
    manifest.mutable_files(i)->set_size(content.size());
    manifest.mutable_files(i)->set_blake2b(blake2b(content));
  }
}

// The archive of a manifest and the files that it lists, one behind the other with a byte 0xff between them.
std::string archived(std::string_view texts) {
  std::string tar;
  std::vector<std::string> contents = split(texts);
  fiona::Manifest manifest;
  google::protobuf::TextFormat::ParseFromString(contents.front(), &manifest);
  if (contents.size() > 1) contents.erase(contents.begin());
  complete(manifest, contents);
  std::string text;
  google::protobuf::TextFormat::PrintToString(manifest, &text);
  TarWriter writer{[&tar](std::string_view bytes) { tar += bytes; }};
  const auto add = [&writer](const std::string& path, const std::string& content, bool executable) {
    writer.begin(path, content.size(), executable);
    writer.write(content);
    writer.end();
  };
  add(std::string(kManifestFile), text, false);
  for (int i = 0; i < manifest.files_size(); ++i)
    add(manifest.files(i).path(), contents.at(static_cast<std::size_t>(i) % contents.size()),
        manifest.files(i).executable());
  writer.close();
  return tar;
}

std::string package_of(int kind, std::string_view input) {
  if (kind == 0) return std::string(input);
  if (kind == 1) return compressed(input);
  try {
    return compressed(archived(input));
  } catch (const fiona::Error&) {  // a path that no archive can have
    return {};
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto kLogBefore = google::protobuf::SetLogHandler(nullptr);  // it tells of each garbled text
  static_cast<void>(kLogBefore);
  if (size == 0) return 0;
  const std::string_view input{reinterpret_cast<const char*>(data) + 1, size - 1};
  const std::string package = package_of(data[0] % 3, input);
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
