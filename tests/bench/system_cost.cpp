#include "system_cost.hpp"

#include <malloc.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <stdexcept>
#include <string>

#include "fiona/modes.hpp"
#include "system_fixture.hpp"

namespace fiona::bench {
namespace {

using conformance::RunningSystem;

double heap_bytes() {
  const struct mallinfo2 all = ::mallinfo2();
  return static_cast<double>(all.uordblks + all.hblkhd);
}

double pss_kib(pid_t process) {
  std::ifstream file("/proc/" + std::to_string(process) + "/smaps_rollup");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("Pss:")) return std::stod(line.substr(4));
  }
  throw std::runtime_error("the kernel does not tell what memory process " + std::to_string(process) + " has");
}

}  // namespace

double instance_kib() {
  constexpr int kInstances = 200;
  RunningSystem system;
  const auto load = [&](int i) { system.load_in("", "mover", "mover" + std::to_string(i), "neutral"); };
  for (int i = 0; i < 10; ++i) load(i);  // what the first ones need, the others share
  const double before = heap_bytes();
  for (int i = 10; i < 10 + kInstances; ++i) load(i);
  return (heap_bytes() - before) / 1024 / kInstances;
}

double group_mib() {
  RunningSystem system;
  // With siblings, as in any system with groups: what they share counts once.
  for (const char* group : {"a", "b", "c", "d"}) system.load_in(group, "mover", std::string("mover_") + group, "neutral");
  return pss_kib(system.group("a").process()) / 1024;
}

double start_s(std::size_t components, std::size_t groups) {
  RunningSystem system;
  std::size_t loaded = 0;
  const auto next_group = [&] { return groups == 0 ? std::string() : "g" + std::to_string(loaded++ % groups); };
  const auto begin = std::chrono::steady_clock::now();
  for (std::size_t i = 0; i < components / 2; ++i) {
    const std::string number = std::to_string(i);
    system.load_in(next_group(), "pacer", "pacer" + number, "period_ms=1000 count=1000000");
    system.load_in(next_group(), "stopwatch", "stopwatch" + number, "count=1000000");
    system.wire("stopwatch" + number + ".samples", "pacer" + number + ".samples");
  }
  system.eventually("all active and connected", [&] {
    const auto now = system.system().snapshot();
    return std::all_of(now.instances().begin(), now.instances().end(), [](const auto& instance) {
      const auto connected = [](const auto& port) { return port.direction() != REQUIRES || port.connection() == control::CONNECTED; };
      return instance.mode() == kModeActive && std::all_of(instance.ports().begin(), instance.ports().end(), connected);
    });
  });
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

}  // namespace fiona::bench
