#include "top_view.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "system_view.hpp"

namespace fiona::console {
namespace {

Table::Cell latency_cell(double latency_ms) {
  return latency_ms <= 0 ? Table::Cell("", nullptr) : Table::Cell(latency_text(latency_ms), latency_ms);
}

Table::Cell count_cell(std::uint64_t count) { return {fmt::format("{}", count), count}; }
Table::Cell age_cell(double age_ms) {
  return age_ms < 0 ? Table::Cell("", nullptr) : Table::Cell(age_text(age_ms), age_ms);
}
Table::Cell share_cell(double percent) {
  return percent < 0 ? Table::Cell("", nullptr) : Table::Cell(fmt::format("{:.1f}%", percent), percent);
}
Table::Cell rate_cell(double rate_hz) { return {rate_text(rate_hz), rate_hz}; }

}  // namespace

/// An instance as one line, of all its ports together.
struct TopView::Row {
  const control::InstanceStatus* instance;
  double busy = -1;            ///< percent; negative: not known yet
  double cpu = -1;             ///< the same
  double rate_hz = 0;          ///< of what it provides, the fastest; of who provides nothing, what comes
  double age_ms = -1;          ///< of the oldest newest message of what it requires and is connected
  double latency_p50_ms = -1;  ///< the slowest port's, as is the next
  double latency_p99_ms = -1;
  std::uint64_t drops = 0;

  double key(Order order) const {
    switch (order) {
      case Order::Busy: return busy;
      case Order::Cpu: return cpu;
      case Order::Queue: return static_cast<double>(instance->queue_depth());
      case Order::Rate: return rate_hz;
      case Order::Age: return age_ms;
      case Order::Latency: return latency_p99_ms;
      case Order::Drops: return static_cast<double>(drops);
      case Order::Name: return 0;
    }
    return 0;
  }
};

void TopView::update(control::System system, std::chrono::steady_clock::time_point taken) {
  const double passed_ms = std::chrono::duration<double, std::milli>(taken - taken_).count();
  std::map<std::string, Times> totals;
  shares_.clear();
  for (const auto& instance : system.instances()) {
    const Times now{.handler = instance.handler_ms(), .cpu = instance.cpu_ms()};
    totals[instance.name()] = now;
    const auto before = totals_.find(instance.name());
    // Less than before: another one of that name.
    if (before == totals_.end() || passed_ms <= 0 || now.handler < before->second.handler) continue;
    // What a handler takes is counted when it ends, some of it before this interval.
    const auto share = [passed_ms](double from, double to) {
      return std::clamp(100 * (to - from) / passed_ms, 0.0, 100.0);
    };
    shares_[instance.name()] = {share(before->second.handler, now.handler), share(before->second.cpu, now.cpu)};
  }
  totals_ = std::move(totals);
  system_ = std::move(system);
  taken_ = taken;
}

std::string TopView::headline() const {
  int wires = 0;
  int not_ok = 0;
  for (const auto& instance : system_.instances()) {
    if (health_text(instance) != "ok") ++not_ok;
    for (const auto& port : instance.ports()) wires += port.connection() == control::CONNECTED ? 1 : 0;
  }
  const int instances = system_.instances_size();
  return fmt::format("{}  {} clock  {} instance{}{}  {} wire{}", system_.host(), system_.clock(), instances,
                     instances == 1 ? "" : "s", not_ok == 0 ? "" : fmt::format(", {} not ok", not_ok), wires,
                     wires == 1 ? "" : "s");
}

std::vector<TopView::Row> TopView::rows(Order order) const {
  std::vector<Row> rows;
  for (const auto& instance : system_.instances()) {
    Row& row = rows.emplace_back(Row{&instance});
    if (const auto found = shares_.find(instance.name()); found != shares_.end()) {
      row.busy = found->second.handler;
      row.cpu = found->second.cpu;
    }
    double came_hz = 0;
    for (const auto& port : instance.ports()) {
      const bool connected = port.connection() == control::CONNECTED;
      if (connected) row.age_ms = std::max(row.age_ms, port.age_ms());
      if (port.direction() == fiona::PROVIDES) row.rate_hz = std::max(row.rate_hz, port.rate_hz());
      if (connected) came_hz = std::max(came_hz, port.rate_hz());
      row.latency_p50_ms = std::max(row.latency_p50_ms, port.latency_p50_ms());
      row.latency_p99_ms = std::max(row.latency_p99_ms, port.latency_p99_ms());
      row.drops += port.dropped() + port.refused();
    }
    if (row.rate_hz == 0) row.rate_hz = came_hz;
  }
  std::stable_sort(rows.begin(), rows.end(), [order](const Row& a, const Row& b) {
    if (a.key(order) != b.key(order)) return a.key(order) > b.key(order);
    return a.instance->name() < b.instance->name();
  });
  return rows;
}

std::vector<std::string> TopView::names(Order order) const {
  std::vector<std::string> names;
  for (const Row& row : rows(order)) names.push_back(row.instance->name());
  return names;
}

Table TopView::instances(Order order) const {
  Table table({"instance", "mode", "busy", "cpu", "queue", "rate", "age", "p50", "p99", "drops", "restarts", "health"});
  table.leave_out_if_empty("restarts");
  for (const Row& row : rows(order)) {
    const auto& instance = *row.instance;
    table.add({instance.name(),
               instance.mode(),
               share_cell(row.busy),
               share_cell(row.cpu),
               count_cell(instance.queue_depth()),
               rate_cell(row.rate_hz),
               age_cell(row.age_ms),
               latency_cell(row.latency_p50_ms),
               latency_cell(row.latency_p99_ms),
               count_cell(row.drops),
               {instance.restarts() == 0 ? "" : std::to_string(instance.restarts()), instance.restarts()},
               health_text(instance)});
  }
  return table;
}

Table TopView::ports(const std::string& name) const {
  Table table({"port", "with", "rate", "age", "p50", "p99", "dropped", "superseded", "refused"});
  const auto* instance = find_instance(system_, name);
  for (int i = 0; instance != nullptr && i < instance->ports_size(); ++i) {
    const auto& port = instance->ports(i);
    const bool required = port.direction() == fiona::REQUIRES;
    const std::string peer = port.peer().instance().empty() ? "" : text_of(port.peer());
    const std::string trouble = port.connection() == control::CONNECTED ? "" : connection_text(port);
    table.add({port.name(),
               !required         ? clients_text(port)
               : trouble.empty() ? peer
                                 : trouble,
               rate_cell(port.rate_hz()), age_cell(port.age_ms()), latency_cell(port.latency_p50_ms()),
               latency_cell(port.latency_p99_ms()), count_cell(port.dropped()), count_cell(port.superseded()),
               count_cell(port.refused())});
  }
  return table;
}

}  // namespace fiona::console
