#include "system_cost.hpp"

#include <fcntl.h>
#include <malloc.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <stdexcept>
#include <string>
#include <thread>

#include "control_client.hpp"
#include "fiona/modes.hpp"
#include "host_process.hpp"
#include "os/process.hpp"
#include "os/read_pages.hpp"
#include "system_fixture.hpp"

namespace fiona::bench {
namespace {

using conformance::RunningSystem;

double heap_bytes() {
  const struct mallinfo2 all = ::mallinfo2();
  return static_cast<double>(all.uordblks + all.hblkhd);
}

Memory memory_of(pid_t process) {
  std::ifstream file("/proc/" + std::to_string(process) + "/smaps_rollup");
  Memory memory;
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("Rss:")) memory.resident = std::stod(line.substr(4));
    if (line.starts_with("Pss:")) memory.proportional = std::stod(line.substr(4));
  }
  if (memory.resident > 0) return memory;
  throw std::runtime_error("the kernel does not tell what memory process " + std::to_string(process) + " has");
}

/// Once it rests, and has let go of what only its start needed.
Memory settled_memory_of(pid_t process) {
  std::this_thread::sleep_for(2 * os::ReadPages::kAfter);
  return memory_of(process);
}

void add_number(control::Load& load, const char* name, std::int64_t value) {
  auto& argument = *load.add_parameters();
  argument.set_name(name);
  argument.mutable_value()->set_integer(value);
}

/// A publisher each millisecond, and its subscriber.
control::Request publisher_and_subscriber() {
  control::Request request;
  auto& changes = *request.mutable_transact();
  auto& pacer = *changes.add_changes()->mutable_load();
  pacer.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/pacer");
  add_number(pacer, "payload", 64);
  add_number(pacer, "period_ms", 1);
  add_number(pacer, "count", 1'000'000);
  auto& stopwatch = *changes.add_changes()->mutable_load();
  stopwatch.set_plugin(std::string(TEST_COMPONENTS_LIBRARY) + "/stopwatch");
  add_number(stopwatch, "count", 1'000'000);
  auto& wire = *changes.add_changes()->mutable_wire();
  wire.mutable_client()->set_instance("stopwatch");
  wire.mutable_client()->set_port("samples");
  wire.mutable_provider()->set_instance("pacer");
  wire.mutable_provider()->set_port("samples");
  return request;
}

std::uint64_t received(const control::System& system) {
  for (const auto& instance : system.instances()) {
    for (const auto& port : instance.ports()) {
      if (instance.name() == "stopwatch" && port.name() == "samples") return port.messages();
    }
  }
  return 0;
}

}  // namespace

double instance_kib() {
  constexpr int kInstances = 200;
  RunningSystem system;
  // Four ports each: that provide, and that require.
  const auto load = [&](int i) {
    const std::string component = i % 2 == 0 ? "station" : "lookout";
    system.load_in("", component, component + std::to_string(i), "neutral");
  };
  for (int i = 0; i < 10; ++i) load(i);  // what the first ones need, the others share
  const double before = heap_bytes();
  for (int i = 10; i < 10 + kInstances; ++i) load(i);
  return (heap_bytes() - before) / 1024 / kInstances;
}

double group_mib(std::size_t groups) {
  RunningSystem system;
  for (std::size_t i = 0; i < groups; ++i) {
    const std::string number = std::to_string(i);
    system.load_in("g" + number, "station", "station" + number, "neutral");
  }
  return settled_memory_of(system.group("g0").process()).proportional / 1024;
}

Memory host_memory() {
  const conformance::TemporaryDirectory directory;
  const auto socket = directory.path / "host.sock";
  console::Reactor reactor;
  console::HostProcess host(reactor,
                            {os::program_directory() / "fiona-host", socket, "bench", directory.path / "store"}, {});
  console::ControlClient client(reactor, {socket}, std::chrono::seconds(5));
  client.call(publisher_and_subscriber());
  control::Request question;
  question.mutable_snapshot();
  for (const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
       std::chrono::steady_clock::now() < end;) {
    const auto system = client.call(question).system();
    if (received(system) >= 1000) return settled_memory_of(system.groups(0).process());
    reactor.run_until([] { return false; }, std::chrono::steady_clock::now() + std::chrono::milliseconds(50));
  }
  throw std::runtime_error("the host's subscriber receives nothing");
}

Memory bare_memory() {
  int input[2], output[2];
  if (::pipe2(input, O_CLOEXEC) != 0 || ::pipe2(output, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
  const os::Descriptor theirs_in(input[0]), ours_in(input[1]), ours_out(output[0]);
  os::Descriptor theirs_out(output[1]);
  const os::ChildProcess process(os::program_directory() / "fiona-bench-bare", {},
                                 {{theirs_in.get(), 0}, {theirs_out.get(), 1}});
  theirs_out.reset();
  char word[8];
  if (::read(ours_out.get(), word, sizeof word) <= 0) throw std::runtime_error("the bare process receives nothing");
  return memory_of(process.id());
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
      const auto connected = [](const auto& port) {
        return port.direction() != REQUIRES || port.connection() == control::CONNECTED;
      };
      return instance.mode() == kModeActive && std::all_of(instance.ports().begin(), instance.ports().end(), connected);
    });
  });
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

}  // namespace fiona::bench
