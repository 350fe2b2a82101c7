#include "through_fiona.hpp"

#include <algorithm>
#include <functional>
#include <stdexcept>
#include <utility>

namespace fiona::bench {
namespace {

using conformance::RunningSystem;

bool any(const conformance::SeenSample&) { return true; }

Latency figures(const conformance::SeenSample& report) {
  return {report.value(), static_cast<double>(report.sent_ns())};
}

void await_connected(RunningSystem& system, const std::string& port) {
  system.eventually("connected", [&] { return system.port(port).connection() == control::CONNECTED; });
}

/// What became of the messages, as far as ports, hosts and links know.
std::string traces(RunningSystem& system, const std::vector<std::string>& ports) {
  std::string text = "messages, of them dropped, and the connection:";
  for (const auto& name : ports) {
    const auto port = system.port(name);
    text += " " + name + " " + std::to_string(port.messages()) + " " + std::to_string(port.dropped()) + " " +
            control::Connection_Name(port.connection());
  }
  const auto now = system.system().snapshot();
  for (const auto& host : now.hosts()) {
    text += "; host " + host.name() + ": " + host.state() + " for " + std::to_string(host.since_s()) + " s";
  }
  for (const auto& group : now.groups()) {
    text += "; links of " + group.name() + ": " + std::to_string(group.links().not_granted()) + " not granted, " +
            std::to_string(group.links().garbled()) + " garbled";
  }
  return text;
}

/// The report of a series; where it does not come, an error that says what became of the messages.
conformance::SeenSample report_of(RunningSystem& system, std::uint64_t report, const std::vector<std::string>& ports) {
  try {
    return system.wait_for(report, any, std::chrono::seconds(30));
  } catch (const std::exception&) {
    throw std::runtime_error("the series does not end; " + traces(system, ports));
  }
}

}  // namespace

Latency push(const Load& load, Transport transport) {
  RunningSystem system(transport);
  const std::string count = "count=" + std::to_string(load.messages);
  system.load_client("stopwatch", "stopwatch", count);
  system.load_provider(
      "pacer", "pacer",
      "neutral payload=" + std::to_string(load.bytes) + " period_ms=" + std::to_string(load.period_ms) + " " + count);
  system.wire("stopwatch.samples", "pacer.samples");
  const auto report = system.watch("stopwatch.report");
  await_connected(system, "stopwatch.samples");
  system.state("pacer", "active");
  return figures(report_of(system, report, {"pacer.samples", "stopwatch.samples"}));
}

Latency query(const Load& load, Transport transport) {
  RunningSystem system(transport);
  system.load_provider("answerer", "answerer");
  system.load_client("prober", "prober",
                     "neutral count=" + std::to_string(load.messages) + " payload=" + std::to_string(load.bytes));
  system.wire("prober.echo", "answerer.echo");
  const auto report = system.watch("prober.report");
  await_connected(system, "prober.echo");
  system.state("prober", "active");
  return figures(system.wait_for(report, any, std::chrono::seconds(60)));
}

namespace {

/// Of what is wired to a pacer again and again, each time after `before`.
Latency wired_to_pacer(RunningSystem& system, const Load& load, const std::function<void()>& before) {
  system.load_client("stopwatch", "stopwatch", "count=1");
  system.load_provider(
      "pacer", "pacer",
      "payload=" + std::to_string(load.bytes) + " period_ms=" + std::to_string(load.period_ms) + " count=1000000000");
  const auto report = system.watch("stopwatch.report");
  std::vector<std::int64_t> latencies;
  for (std::size_t i = 0; i <= load.messages; ++i) {
    before();
    const std::int64_t begun_ns = steady_ns();
    system.wire("stopwatch.samples", "pacer.samples");
    const auto first = system.wait_for(
        report, [&](const auto& sample) { return static_cast<std::int64_t>(sample.number()) > begun_ns; });
    if (i > 0) latencies.push_back(static_cast<std::int64_t>(first.number()) - begun_ns);  // the first makes the link
  }
  return summarise(std::move(latencies));
}

}  // namespace

Latency wire_to_first_message(const Load& load, Transport transport) {
  RunningSystem system(transport);
  bool wired = false;
  return wired_to_pacer(system, load, [&] {
    if (std::exchange(wired, true)) system.unwire("stopwatch.samples");
  });
}

Latency rewire_to_first_message(const Load& load, Transport transport) {
  RunningSystem system(transport);
  system.load_provider("pacer", "calm", "period_ms=10000 count=1000000000");
  return wired_to_pacer(system, load, [&] {
    system.wire("stopwatch.samples", "calm.samples");
    await_connected(system, "stopwatch.samples");
  });
}

Latency stream(const Load& load, std::size_t consumers, std::size_t window, Transport transport) {
  RunningSystem system(transport);
  const std::string common = " count=" + std::to_string(load.messages) + " window=" + std::to_string(window) +
                             " payload=" + std::to_string(load.bytes) + " counters=" + std::to_string(consumers);
  system.load_provider("flooder", "flooder", "neutral" + common);
  std::vector<std::uint64_t> reports;
  std::vector<std::string> ports{"flooder.samples"};
  for (std::size_t i = 0; i < consumers; ++i) {
    const std::string number = std::to_string(i);
    const std::string counter = "counter" + number;
    system.load_client("counter", counter, "index=" + number + common);
    system.wire(counter + ".samples", "flooder.samples");
    system.wire("flooder.progress" + number, counter + ".progress");
    reports.push_back(system.watch("counter" + number + ".report"));
    for (const std::string& port : {counter + ".samples", "flooder.progress" + number}) await_connected(system, port);
    for (const std::string& port : {counter + ".samples", counter + ".progress", "flooder.progress" + number})
      ports.push_back(port);
  }
  system.state("flooder", "active");
  Latency slowest;
  for (const auto report : reports) {
    const auto one = report_of(system, report, ports);
    slowest.median_ns = std::max(slowest.median_ns, one.value());
  }
  return slowest;
}

}  // namespace fiona::bench
