// The index of a marketplace, which strangers fill: any bytes give a marketplace or one fiona::Error, and each package
// that it offers can be found by its name.
#include <google/protobuf/stubs/logging.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fiona/error.hpp>
#include <fiona/marketplace/index.hpp>
#include <fstream>
#include <string>
#include <string_view>

#include "../temporary_directory.hpp"
#include "index_file.hpp"

namespace {

using fiona::marketplace::Marketplace;

void refuses_version(const Marketplace& market, const std::string& name) {
  try {
    market.resolve(name + "@none");
  } catch (const fiona::Error& error) {
    if (error.code() == fiona::ErrorCode::NotFound) return;
  }
  std::abort();
}

void use(const Marketplace& market) {
  for (const auto& entry : market.search({})) {
    const std::string name = entry.manifest().publisher() + "/" + entry.manifest().name();
    if (market.info(name).empty() || market.search({entry.manifest().name()}).empty()) std::abort();
    if (!market.resolve(name + "@" + entry.manifest().version()).version) std::abort();
    refuses_version(market, name);
    for (const auto& component : entry.interface().components()) {
      for (const auto& port : component.ports()) market.providers_of(port.service());
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto kLogBefore = google::protobuf::SetLogHandler(nullptr);  // it tells of each garbled message
  static_cast<void>(kLogBefore);
  static const fiona::tests::TemporaryDirectory kDirectory;
  std::ofstream(kDirectory.path / fiona::marketplace::kIndexFile, std::ios::binary)
      << std::string_view(reinterpret_cast<const char*>(data), size);
  try {
    use(Marketplace(kDirectory.path));
  } catch (const fiona::Error& error) {
    if (error.text().what.empty()) std::abort();
  }
  return 0;
}
