#include "market_cost.hpp"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fiona/marketplace/index.hpp>
#include <fiona/marketplace/keeper.hpp>
#include <fiona/marketplace/package.hpp>
#include <fiona/marketplace/plan.hpp>
#include <fstream>
#include <functional>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "os/process.hpp"
#include "system_fixture.hpp"

namespace fiona::bench {
namespace {

namespace filesystem = std::filesystem;
using Steady = std::chrono::steady_clock;

constexpr int kPackages = 5000;
constexpr int kChain = 50;
constexpr int kRounds = 7;
constexpr int kFiles = 10;
constexpr std::size_t kFileBytes = 500'000;

double seconds_of(const std::function<void()>& work) {
  const auto begun = Steady::now();
  work();
  return std::chrono::duration<double>(Steady::now() - begun).count();
}

double median_s(const std::function<void()>& work) {
  std::vector<double> times;
  for (int i = 0; i < kRounds; ++i) times.push_back(seconds_of(work));
  std::ranges::sort(times);
  return times[times.size() / 2];
}

std::string name_of(int package) { return "p" + std::to_string(package); }

// Package n requires the next in its chain of 50, and two others after it.
void add_version(Index& index, int package, const std::string& version) {
  IndexEntry& entry = *index.add_entries();
  Manifest& manifest = *entry.mutable_manifest();
  manifest.set_publisher("acme");
  manifest.set_name(name_of(package));
  manifest.set_version(version);
  manifest.set_kind(DATA);
  manifest.set_summary("one of many");
  manifest.set_license("Apache-2.0");
  for (const int other : {package + 1, package + 7, package + 13}) {
    if (other / kChain == package / kChain) manifest.add_requirements("acme/" + name_of(other) + " >= 1.0.0, < 3.0.0");
  }
  for (const auto name : {marketplace::kInterfaceFile, marketplace::kReadmeFile}) {
    PackageFile& file = *manifest.add_files();
    file.set_path(std::string(name));
    file.set_blake2b(std::string(64, '0'));
  }
  ComponentInterface& component = *entry.mutable_interface()->add_components();
  component.set_name(name_of(package));
  for (int i = 0; i < 4; ++i) {
    PortInterface& port = *component.add_ports();
    port.set_name("port" + std::to_string(i));
    port.set_direction(i % 2 == 0 ? PROVIDES : REQUIRES);
    port.set_service("acme.many.Service" + std::to_string((package + i) % 997));
  }
  entry.set_blake2b(std::string(64, '0'));
  entry.set_file("acme." + name_of(package) + "-" + version + "-any-" + std::string(16, '0') + ".fpk");
  entry.set_size(1);
}

void write(const filesystem::path& file, const std::string& bytes) {
  std::ofstream(file, std::ios::binary) << bytes;
  if (filesystem::file_size(file) != bytes.size()) throw std::runtime_error("could not write " + file.string());
}

// Half of it compresses.
std::string content(unsigned seed) {
  std::mt19937 random(seed);
  std::string bytes(kFileBytes, 'x');
  for (std::size_t i = 0; i < bytes.size(); i += 2) bytes[i] = static_cast<char>(random());
  return bytes;
}

filesystem::path publish_large(const filesystem::path& directory) {
  marketplace::PackageSource source;
  source.manifest = "publisher: 'acme' name: 'large' version: '1.0.0' kind: DATA summary: 's' license: 'Apache-2.0'";
  source.readme = "# large\n";
  source.share = directory / "share";
  filesystem::create_directory(source.share);
  for (unsigned i = 0; i < kFiles; ++i) write(source.share / ("map" + std::to_string(i)), content(i));
  marketplace::pack_to(directory / "large.fpk", source);
  marketplace::make_market({directory / "large.fpk"}, directory / "market",
                           {.keys = tuf::SigningKeys{directory / "signing"}});
  return directory / "large.fpk";
}

void run(const std::string& line) {
  if (std::system(line.c_str()) != 0) throw std::runtime_error("failed: " + line);
}

}  // namespace

double plan_s() {
  const conformance::TemporaryDirectory directory;
  Index index;
  for (int i = 0; i < kPackages; ++i) {
    add_version(index, i, "1.0.0");
    add_version(index, i, "2.0.0");
  }
  write(directory.path / "index.binpb", index.SerializeAsString());
  return median_s([&] {
    const marketplace::Marketplace market(directory.path);
    const auto plan = marketplace::plan_install({"p0"}, market, marketplace::Store(directory.path / "store"));
    if (plan.steps.size() != kChain)
      throw std::runtime_error("the plan has " + std::to_string(plan.steps.size()) + " steps");
  });
}

double install_beyond_script_ms() {
  const conformance::TemporaryDirectory directory;
  const std::string package = publish_large(directory.path).string(), root = directory.path.string();
  const std::string fiona =
      "FIONA_KEYS=" + root + "/keys XDG_CACHE_HOME=" + root + "/cache " + (os::program_directory() / "fiona").string();
  const std::string ours = fiona + " market install large -q -y --from " + root + "/market --store " + root + "/store";
  run(fiona + " keys trust -q " + root + "/market.root.json --from " + root + "/market");
  const std::string bare = "set -e; cd " + root + "; b2sum -l 256 " + package +
                           " >/dev/null; mkdir staged packages; zstd -qdc " + package +
                           " | tar -x -C staged; find staged -type f -exec b2sum -l 256 {} + >/dev/null; "
                           "find staged -exec sync {} +; mv staged packages/hash; sync packages .";
  const auto remove = [&] {
    for (const char* name : {"store", "staged", "packages", "cache"}) filesystem::remove_all(directory.path / name);
  };
  std::vector<double> beyond_ms;
  for (int i = 0; i < kRounds; ++i) {  // in turns, so that a change of the machine's mood meets both
    remove();
    const double bare_s = seconds_of([&] { run(bare); });
    remove();
    beyond_ms.push_back(1e3 * (seconds_of([&] { run(ours); }) - bare_s));
  }
  std::ranges::sort(beyond_ms);
  return beyond_ms[beyond_ms.size() / 2];
}

}  // namespace fiona::bench
