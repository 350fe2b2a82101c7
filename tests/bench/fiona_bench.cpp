// fiona-bench: every goal of speed as one line, NAME FIGURE GOAL ok|short, each a ratio to a bare limit measured in
// turns in the same run. Exit code 1 if any is short. With an argument: those goals only whose names contain it.
//
// Provider and consumer are plugins loaded by a host, in one process or in two.
#include <algorithm>
#include <cstdio>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "bare_limits.hpp"
#include "os/process.hpp"
#include "probe_cost.hpp"
#include "system_cost.hpp"
#include "system_fixture.hpp"

namespace {

using fiona::bench::Latency;
using fiona::bench::Load;
using fiona::conformance::RunningSystem;
using fiona::conformance::Transport;

constexpr int kRounds = 5;

struct Goal {
  const char* name;
  double at_most;
  Load load;
  std::function<Latency(const Load&)> ours;
  std::function<Latency(const Load&)> bare;
};

Latency through_fiona(const Load& load, Transport transport) {
  RunningSystem system(transport);
  const std::string count = "count=" + std::to_string(load.messages);
  system.load_client("stopwatch", "stopwatch", count);
  system.load_provider("pacer", "pacer", "neutral payload=" + std::to_string(load.bytes) + " period_ms=" +
                                             std::to_string(load.period_ms) + " " + count);
  system.wire("stopwatch.samples", "pacer.samples");
  const auto report = system.watch("stopwatch.report");
  system.eventually("connected", [&] { return system.port("stopwatch.samples").connection() == fiona::control::CONNECTED; });
  system.state("pacer", "active");
  try {
    return {system.wait_for(report, [](const auto&) { return true; }, std::chrono::seconds(20)).value(), 0};
  } catch (const std::exception&) {
    const auto sent = system.port("pacer.samples");
    const auto received = system.port("stopwatch.samples");
    throw std::runtime_error("of " + std::to_string(sent.messages()) + " messages " + std::to_string(received.messages()) +
                             " arrived; dropped: " + std::to_string(sent.dropped()) + " by the sender, " +
                             std::to_string(received.dropped()) + " by the receiver");
  }
}

Latency query_across(const Load& load) {
  RunningSystem system(Transport::Ipc);
  system.load_provider("answerer", "answerer");
  system.load_client("prober", "prober",
                     "neutral count=" + std::to_string(load.messages) + " payload=" + std::to_string(load.bytes));
  system.wire("prober.echo", "answerer.echo");
  const auto report = system.watch("prober.report");
  system.state("prober", "active");
  return {system.wait_for(report, [](const auto&) { return true; }, std::chrono::seconds(60)).value(), 0};
}

/// From the command that wires to the consumer's first message.
Latency wire_to_first_message(const Load& load, Transport transport) {
  RunningSystem system(transport);
  system.load_client("stopwatch", "stopwatch", "count=1");
  system.load_provider("pacer", "pacer", "payload=" + std::to_string(load.bytes) + " period_ms=" + std::to_string(load.period_ms) +
                                             " count=1000000000");
  const auto report = system.watch("stopwatch.report");
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i <= load.messages; ++i) {
    const std::int64_t begun_ns = fiona::bench::steady_ns();
    system.wire("stopwatch.samples", "pacer.samples");
    const auto first = system.wait_for(report, [&](const auto& sample) { return static_cast<std::int64_t>(sample.number()) > begun_ns; });
    if (i > 0) latencies.push_back(static_cast<std::int64_t>(first.number()) - begun_ns);  // the first makes the link
    system.unwire("stopwatch.samples");
  }
  return fiona::bench::summarise(std::move(latencies));
}

/// The slowest of the counters says how long each message took; `window` messages may be under way.
Latency stream_across(const Load& load, std::size_t counters, std::size_t window) {
  RunningSystem system(Transport::Ipc);
  const std::string common = " count=" + std::to_string(load.messages) + " window=" + std::to_string(window) +
                             " payload=" + std::to_string(load.bytes) + " counters=" + std::to_string(counters);
  system.load_provider("flooder", "flooder", "neutral" + common);
  std::vector<std::uint64_t> reports;
  for (std::size_t i = 0; i < counters; ++i) {
    const std::string number = std::to_string(i);
    system.load_client("counter", "counter" + number, "index=" + number + common);
    system.wire("counter" + number + ".samples", "flooder.samples");
    system.wire("flooder.progress" + number, "counter" + number + ".progress");
    reports.push_back(system.watch("counter" + number + ".report"));
  }
  system.state("flooder", "active");
  Latency slowest;
  for (const auto report : reports) {
    const auto one = system.wait_for(report, [](const auto&) { return true; }, std::chrono::seconds(60));
    slowest.median_ns = std::max(slowest.median_ns, one.value());
  }
  return slowest;
}

/// A cost that has no bare limit beside it.
struct Cost {
  const char* name;
  double at_most;
  const char* unit;
  std::function<double()> measure;
};

bool run(const Cost& cost) {
  const double figure = cost.measure();
  const bool ok = figure <= cost.at_most;
  std::printf("%-44s %5.2f %s   <= %.2f %s   %s\n", cost.name, figure, cost.unit, cost.at_most, cost.unit, ok ? "ok" : "short");
  std::fflush(stdout);
  return ok;
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

/// Ours and the limit in turns, so that a change of the machine's mood meets both.
bool run(const Goal& goal) {
  std::vector<double> ratios, ours_us, bare_us;
  for (int round = 0; round < kRounds; ++round) {
    const Latency bare = goal.bare(goal.load);
    const Latency ours = goal.ours(goal.load);
    ratios.push_back(ours.median_ns / bare.median_ns);
    ours_us.push_back(ours.median_ns / 1e3);
    bare_us.push_back(bare.median_ns / 1e3);
  }
  const double ratio = median(ratios);
  const bool ok = ratio <= goal.at_most;
  std::printf("%-44s %5.2fx   <= %.2fx   %s   (%.2f us, limit %.2f us)\n", goal.name, ratio, goal.at_most,
              ok ? "ok" : "short", median(ours_us), median(bare_us));
  std::fflush(stdout);
  return ok;
}

}  // namespace

int main(int argc, char** argv) {
  fiona::os::keep_freed_memory();  // as a host; for the bare limits too
  if (argc == 4 && std::string(argv[1]) == "--zeromq-receiver") {
    return fiona::bench::receive_zeromq(argv[2], static_cast<std::size_t>(std::stoul(argv[3])));
  }
  if (argc == 3 && std::string(argv[1]) == "--zeromq-answerer") return fiona::bench::answer_zeromq(argv[2]);
  if (argc == 5 && std::string(argv[1]) == "--zeromq-counter") {
    return fiona::bench::count_zeromq(argv[2], static_cast<std::size_t>(std::stoul(argv[3])), static_cast<std::size_t>(std::stoul(argv[4])));
  }
  if (argc == 4 && std::string(argv[1]) == "--zeromq-publisher") return fiona::bench::publish_zeromq(argv[2], std::stod(argv[3]));
  const std::string self = argv[0];
  const std::string only = argc == 2 ? argv[1] : "";
  const Load small{64, 2000, 0.5};
  const Load large{1024 * 1024, 100, 20};
  const auto in_process = [](const Load& load) { return through_fiona(load, Transport::Process); };
  const auto across_groups = [](const Load& load) { return through_fiona(load, Transport::Ipc); };
  const auto zeromq = [&self](const Load& load) { return fiona::bench::through_zeromq(load, self); };
  const auto zeromq_query = [&self](const Load& load) { return fiona::bench::query_through_zeromq(load, self); };
  const auto zeromq_stream = [&self](std::size_t receivers) {
    return [&self, receivers](const Load& load) { return fiona::bench::stream_through_zeromq(load, receivers, self); };
  };
  const auto stream = [](std::size_t counters, std::size_t window) {
    return [counters, window](const Load& load) { return stream_across(load, counters, window); };
  };
  const Load rewired{64, 100, 0.2};
  const auto wire_to_first = [](Transport transport) {
    return [transport](const Load& load) { return wire_to_first_message(load, transport); };
  };
  const auto zeromq_connect = [&self](const Load& load) { return fiona::bench::connect_over_zeromq(load, self); };
  const Goal goals[] = {
      {"push 64 B, one process, p50 / queue", 2.0, small, in_process, fiona::bench::through_queue},
      {"push 1 MiB, one process, p50 / queue", 2.0, large, in_process, fiona::bench::through_queue},
      {"push 64 B, two groups, p50 / bare ZeroMQ ipc", 1.5, small, across_groups, zeromq},
      {"push 1 MiB, two groups, p50 / bare ZeroMQ ipc", 2.0, large, across_groups, zeromq},
      {"query 64 B, two groups, p50 / bare ZeroMQ", 1.25, {64, 3000, 0}, query_across, zeromq_query},
      {"query 1 MiB, two groups, p50 / bare ZeroMQ", 1.25, {1024 * 1024, 200, 0}, query_across, zeromq_query},
      {"stream 64 B, two groups / bare ZeroMQ", 1 / 0.5, {64, 300'000, 0}, stream(1, 8000), zeromq_stream(1)},
      {"stream 1 MiB, two groups / bare ZeroMQ", 1 / 0.85, {1024 * 1024, 400, 0}, stream(1, 3), zeromq_stream(1)},
      {"stream 1 MiB to 8 of a group / bare ZeroMQ", 1.0, {1024 * 1024, 200, 0}, stream(8, 3), zeromq_stream(8)},
      {"wire to first message, one process / queue", 2.5, rewired, wire_to_first(Transport::Process), fiona::bench::connect_to_queue},
      {"wire to first message, two groups / ZeroMQ", 0.5, rewired, wire_to_first(Transport::Ipc), zeromq_connect},
      {"probe set, nobody watches / lock and clock", 2.0, small, fiona::bench::set_of_probe, fiona::bench::locked_store},
  };
  const Cost costs[] = {
      {"idle instance with four ports, heap", 32, "KiB", fiona::bench::instance_kib},
      {"group with one instance, PSS", 2.5, "MiB", fiona::bench::group_mib},
      {"start of 100 components in main", 1, "s", [] { return fiona::bench::start_s(100, 0); }},
      {"start of 100 components in 10 groups", 1, "s", [] { return fiona::bench::start_s(100, 10); }},
      {"start of 100 components in 100 groups", 1, "s", [] { return fiona::bench::start_s(100, 100); }},
      {"start of 1000 components in main", 30, "s", [] { return fiona::bench::start_s(1000, 0); }},
      {"start of 1000 components in 100 groups", 30, "s", [] { return fiona::bench::start_s(1000, 100); }},
  };
  const auto wanted = [&only](std::string_view name) { return name.find(only) != std::string_view::npos; };
  bool all = true;
  try {
    for (const Goal& goal : goals) {
      if (wanted(goal.name)) all = run(goal) && all;
    }
    for (const Cost& cost : costs) {
      if (wanted(cost.name)) all = run(cost) && all;
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
  }
  return all ? 0 : 1;
}
