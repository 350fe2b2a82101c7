#pragma once

#include <array>
#include <chrono>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "fiona/control.pb.h"
#include "table.hpp"

namespace fiona::console {

/// What `top` shows of one snapshot after the other, without a terminal.
class TopView {
 public:
  /// By what the rows are ordered; the largest first, names as in a book.
  enum class Order { Busy, Cpu, Queue, Rate, Age, Latency, Drops, Name };
  static constexpr std::array<std::string_view, 8> kOrders{"busy", "cpu", "queue", "rate",
                                                           "age",  "p99", "drops", "instance"};

  /// A snapshot that was taken at this moment of the machine's clock.
  void update(control::System system, std::chrono::steady_clock::time_point taken);

  /// "museum  system clock  12 instances, 2 not ok  20 wires".
  std::string headline() const;
  /// The instances' names in that order, as the rows of `instances` stand.
  std::vector<std::string> names(Order order) const;
  /// One row an instance: busy is the share of the time that its handlers took since the snapshot before, cpu what they
  /// had of a CPU meanwhile.
  Table instances(Order order) const;
  /// One row a port; empty: the instance is there no more.
  Table ports(const std::string& instance) const;

 private:
  struct Row;
  std::vector<Row> rows(Order order) const;

  control::System system_;
  std::chrono::steady_clock::time_point taken_{};
  struct Times {
    double handler = 0;
    double cpu = 0;
  };
  std::map<std::string, Times> shares_;  ///< percent; of those that were there before
  std::map<std::string, Times> totals_;  ///< ms; of the snapshot before
};

}  // namespace fiona::console
