#define BOOST_DLL_USE_STD_FS
#include "load_cost.hpp"

#include <algorithm>
#include <atomic>
#include <boost/dll/shared_library.hpp>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "fiona/marketplace/hash.hpp"
#include "fiona/plugin.hpp"
#include "package.hpp"
#include "plugin_library.hpp"
#include "system_fixture.hpp"

namespace fiona::bench {
namespace {

/// A file of its own for each load; what has been mapped outlives the name.
template <class F>
Latency each_copy(const Load& load, F open) {
  const conformance::TemporaryDirectory directory;
  std::vector<std::int64_t> times;
  for (std::size_t i = 0; i < load.messages; ++i) {
    const auto copy = directory.path / ("libsmall" + std::to_string(i) + ".so");
    std::filesystem::copy_file(SMALL_COMPONENT_LIBRARY, copy);
    const std::int64_t begun_ns = steady_ns();
    open(copy);
    times.push_back(steady_ns() - begun_ns);
  }
  return summarise(std::move(times));
}

}  // namespace

Latency plugin_load(const Load& load) {
  host::PluginLibraries libraries;
  const conformance::TemporaryDirectory store;
  const auto choice = host::Packages(store.path).find(SMALL_COMPONENT_LIBRARY);
  const Interface& interface = choice.package->interface;
  return each_copy(load, [&](const std::filesystem::path& copy) {
    host::PluginLibraries::Files files;
    files.Add()->set_path(copy);
    if (libraries.open("local/" + copy.stem().string(), files, interface).entries().size() != 1)
      throw std::runtime_error("no component");
  });
}

Latency bare_load(const Load& load) {
  namespace dll = boost::dll;
  static auto& opened = *new std::vector<dll::shared_library>;  // as a host: to the end of the process
  return each_copy(load, [](const std::filesystem::path& copy) {
    opened.emplace_back(copy, dll::load_mode::rtld_now | dll::load_mode::rtld_local);
    if (!opened.back().get<const PluginEntry*()>(kPluginEntrySymbol)) throw std::runtime_error("no entry");
  });
}

double hash_us_per_mib() {
  std::stringstream text;
  text << std::ifstream(TEST_COMPONENTS_LIBRARY, std::ios::binary).rdbuf();
  const std::string library = text.str();
  std::vector<std::int64_t> times;
  for (int i = 0; i < 20; ++i) {
    const std::int64_t begun_ns = steady_ns();
    if (!marketplace::is_blake2b(marketplace::blake2b(library))) throw std::runtime_error("no hash");
    times.push_back(steady_ns() - begun_ns);
  }
  return summarise(std::move(times)).median_ns / 1e3 / (static_cast<double>(library.size()) / (1024.0 * 1024.0));
}

}  // namespace fiona::bench
